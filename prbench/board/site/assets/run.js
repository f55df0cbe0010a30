"use strict";
// The page of one run: spread over recordings, timing of primes, failures worst first, and the motions behind them.
(() => {
  const { make, draw, data, ticks, arrivedAt, openPlayer, address } = window.prbench.site;
  const told = data();
  const PAGE = 15;

  const shownOf = (table) => (arrivedAt(table) || []).filter((sequence) => sequence.runs[told.run]);
  const everything = told.tables.flatMap(({ table }) => shownOf(table));
  const open = (id, time) => openPlayer(everything, [{ key: told.run, label: told.label }], id, time);
  const link = (sequence, time, text) => make("a", {
    class: "look",
    href: `#sequence=${encodeURIComponent(sequence.sequence_id)}&t=${time.toFixed(2)}`,
    "aria-label": `${text}: ${sequence.title}, at ${time.toFixed(2)} s`,
    text,
    onclick: (event) => {
      event.preventDefault();
      history.replaceState(null, "", event.currentTarget.getAttribute("href"));
      open(sequence.sequence_id, time);
    },
  });

  // One dot a recording, as large as it has sequences, in lanes so that none covers another.
  const strip = (part, metric) => {
    const recordings = part.spread[metric.id] || [];
    const [mean, low, high] = part.means[metric.id] || [null, null, null];
    const width = 520;
    const most = Math.max(...recordings.map(([, , count]) => count), 1);
    const values = recordings.map(([, value]) => value);
    const range = metric.rate ? [0, 100] : [Math.min(0, ...values), Math.max(...values, high || 0) * 1.05 || 1];
    const at = (value) => 14 + ((value - range[0]) / (range[1] - range[0] || 1)) * (width - 28);
    const lanes = [];
    const dots = [...recordings].sort((one, other) => one[1] - other[1]).map(([name, value, count]) => {
      const r = 2.5 + 4 * Math.sqrt(count / most);
      const x = at(value);
      let lane = lanes.findIndex((end) => end < x - r);
      if (lane < 0) lane = lanes.length;
      lanes[lane] = x + r + 0.5;
      return { name, value, count, x, r, lane };
    });
    const step = Math.min(13, 150 / Math.max(lanes.length, 1));
    const height = 34 + Math.max(lanes.length, 2) * step + 22;
    const base = height - 28;
    const words = `${metric.title} of ${recordings.length} recordings, from ${Math.min(...values).toFixed(2)} to `
      + `${Math.max(...values).toFixed(2)}${metric.unit}; mean over sequences ${mean === null ? "–" : mean.toFixed(2)}`;
    const svg = draw("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": words });
    for (const value of ticks(...range, 6)) {
      svg.append(draw("line", { class: "grid", x1: at(value), x2: at(value), y1: 8, y2: base + 6 }),
        draw("text", { class: "tick", x: at(value), y: height - 6, "text-anchor": "middle", text: `${value}` }));
    }
    for (const { name, value, count, x, r, lane } of dots) {
      svg.append(draw("circle", { class: "dot", cx: x, cy: base - 6 - lane * step, r },
        draw("title", { text: `${name}: ${value.toFixed(2)}${metric.unit}, ${count} sequences` })));
    }
    if (mean !== null) {
      svg.append(draw("line", { class: "mean-line", x1: at(mean), x2: at(mean), y1: 10, y2: base + 4 }));
      if (low !== null) svg.append(draw("line", { class: "span", x1: at(low), x2: at(high), y1: base + 4, y2: base + 4 }));
    }
    return svg;
  };

  const spread = (part) => {
    const figure = make("figure", {});
    const select = make("select", {}, ...part.metrics.map((metric) => make("option", { value: metric.id, text: metric.title })));
    const place = make("div", {});
    const show = () => place.replaceChildren(strip(part, part.metrics.find(({ id }) => id === select.value)));
    select.addEventListener("input", show);
    figure.append(make("figcaption", {}, "Spread over recordings: ", make("label", {}, make("span", { class: "unseen", text: "Metric" }), select)),
      place, make("p", { class: "hint", text: "A dot is a recording, larger with more sequences; the line is the mean over sequences with its 95 % interval." }));
    show();
    return figure;
  };

  const timing = (part) => {
    const { first, width, counts, earlier, later, from_the_start: already, never, text } = part.timing;
    const bars = [["before", earlier], ...counts.map((count, i) => [first + i * width, count]), ["after", later]];
    const beside = [["from the start", already], ["never (no hit)", never]];
    const most = Math.max(...bars.map(([, count]) => count), ...beside.map(([, count]) => count), 1);
    const total = 590;
    const height = 210;
    const base = height - 44;
    const wide = 390 / bars.length;
    const up = (count) => (count / most) * (base - 18);
    const svg = draw("svg", { viewBox: `0 0 ${total} ${height}`, role: "img", "aria-label": text });
    for (const value of ticks(0, most, 4).filter(Number.isInteger)) {
      svg.append(draw("line", { class: "grid", x1: 36, x2: total - 6, y1: base - up(value), y2: base - up(value) }),
        draw("text", { class: "tick", x: 30, y: base - up(value) + 4, "text-anchor": "end", text: String(value) }));
    }
    bars.forEach(([name, count], i) => {
      const outside = typeof name === "string";
      const words = outside ? `${name} ${outside && name === "before" ? first : -first} s` : `${name.toFixed(1)} to ${(name + width).toFixed(1)} s`;
      svg.append(draw("rect", { class: outside ? "bar-out" : "bar-in", x: 40 + i * wide + 0.5, width: wide - 1, y: base - up(count), height: up(count) },
        draw("title", { text: `${words}: ${count}` })));
    });
    const zero = 40 + wide * (1 + -first / width);
    svg.append(draw("line", { class: "mean-line", x1: zero, x2: zero, y1: 8, y2: base }));
    svg.append(draw("text", { class: "tick", x: 40, y: base + 15, text: `before ${first}` }),
      draw("text", { class: "tick", x: 432, y: base + 15, "text-anchor": "end", text: `after +${-first}` }));
    for (const second of [-1, 0, 1]) {
      const x = zero + (second / width) * wide;
      svg.append(draw("text", { class: "tick", x, y: base + 15, "text-anchor": "middle", text: second > 0 ? `+${second}` : String(second) }));
    }
    svg.append(draw("text", { class: "axis", x: zero, y: base + 33, "text-anchor": "middle", text: "seconds after the recorded prime" }));
    beside.forEach(([name, count], i) => {
      const x = 482 + i * 62;
      svg.append(draw("rect", { class: i ? "bar-miss" : "bar-out", x: x - 15, width: 30, y: base - up(count), height: up(count) }),
        draw("text", { class: "tick", x, y: base - up(count) - 4, "text-anchor": "middle", text: String(count) }));
      name.split(" ").reduce((lines, word) => {
        if (lines.length && (lines.at(-1) + word).length < 9) lines[lines.length - 1] += ` ${word}`;
        else lines.push(word);
        return lines;
      }, []).forEach((line, row) => svg.append(draw("text", { class: "tick", x, y: base + 13 + row * 12, "text-anchor": "middle", text: line })));
    });
    return make("figure", {}, make("figcaption", { text: "When the head comes to the goal" }), svg, make("p", { class: "hint", text }));
  };

  const failures = (part) => {
    const shown = new Map(shownOf(part.table).map((sequence) => [sequence.sequence_id, sequence]));
    const list = make("ol", { class: "failures" });
    const words = part.failed ? `${part.failed} of ${part.scored} sequences lost a rate, the worst first` : `None of ${part.scored} sequences lost a rate`;
    const figure = make("figure", { class: "wide" }, make("figcaption", { text: words }), list);
    let next = 0;
    const more = make("button", { type: "button", onclick: () => add() });
    const add = () => {
      for (const { sequence_id: id, lost, moment } of part.failures.slice(next, next + PAGE)) {
        const sequence = shown.get(id);
        const look = sequence ? [link(sequence, sequence[moment], moment === "prime" ? "Watch the prime" : "Watch the event")] : [];
        list.append(make("li", {}, make("span", { class: "lost", text: lost.join(", ") }), ...look, make("code", { text: id.slice(id.indexOf("/") + 1) })));
      }
      next += PAGE;
      more.hidden = next >= part.failures.length;
      more.textContent = `Show ${Math.min(PAGE, part.failures.length - next)} more`;
    };
    add();
    figure.append(more);
    if (part.failed > part.failures.length) {
      figure.append(make("p", { class: "hint", text: `The ${part.failures.length} worst are named here; scores.parquet of the run holds all.` }));
    }
    return figure;
  };

  for (const part of told.tables) {
    const place = document.querySelector(`.charts[data-table="${part.table}"]`);
    place.append(spread(part), ...(part.timing ? [timing(part)] : []), failures(part));
    const shown = shownOf(part.table);
    if (shown.length) {
      const start = shown[0];
      place.append(make("p", { class: "wide" }, link(start, start.prime, `Look at ${shown.length} motions`)));
    }
  }
  const compare = document.getElementById("compare");
  compare.href += `#first=${encodeURIComponent(told.run)}`;
  document.getElementById("with").hidden = false;

  const follow = () => {
    const id = address().get("sequence");
    const sequence = everything.find((each) => each.sequence_id === id);
    if (sequence) open(id, Number(address().get("t")) || 0);
  };
  follow();
})();
