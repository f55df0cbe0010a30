"use strict";
// The page of one run: spread over recordings, timing of primes, failures worst first, and the motions behind them.
(() => {
  const { make, draw, data, ticks, badges, arrivedAt, openPlayer, address } = window.prbench.site;
  const told = data();
  const PAGE = 15;

  const shownOf = (table) => (arrivedAt(table) || []).filter((sequence) => sequence.runs[told.run]);
  const everything = told.tables.flatMap(({ table }) => shownOf(table));
  const look = (id, time) => openPlayer(everything, [{ key: told.run, label: told.label }], id, time);
  const link = (sequence, time, text) => make("a", {
    class: "look",
    href: `#sequence=${encodeURIComponent(sequence.sequence_id)}&t=${time.toFixed(2)}`,
    "aria-label": `${text}: ${sequence.title}, at ${time.toFixed(2)} s`,
    text,
    onclick: (event) => {
      event.preventDefault();
      history.replaceState(null, "", event.currentTarget.getAttribute("href"));
      look(sequence.sequence_id, time);
    },
  });

  // --- what the run is: its record as the board has it ---
  const first = told.tables[0].row;
  const scale = ({ unit }) => (unit === "rate" ? 100 : 1);
  const unitOf = ({ unit }) => (unit === "rate" ? " %" : unit === "ratio" ? "" : ` ${unit}`);
  document.getElementById("variant").textContent = first.variant;
  const open = told.tables.map(({ row }) => row.unverified).find(Boolean);
  document.getElementById("badges").append(...badges({ control: first.record.method.kind === "control" || first.record.control, open, why: open || first.verified }));
  const remarks = told.tables.flatMap(({ row, remarks: words }) => [...words, ...(row.unverified ? [`unverified, because ${row.unverified}`] : [])]
    .map((word) => `${row.summary.dataset}: ${word}`));
  remarks.push(`Declared by the run, and shown by nothing but running the method: ${first.declared.join(", ")}.`);
  document.getElementById("remarks").append(...remarks.map((text) => make("li", { text })));
  const { record } = first;
  const pairs = (values) => Object.entries(values).map(([key, value]) => `${key}${value === "" ? "" : ` ${value}`}`).join(", ");
  const facts = [
    ["Method (declared)", `${record.method.name} ${record.method.version}`], ["Kind (declared)", first.origin],
    ["Given", record.condition + (record.control ? `, control ${record.control}` : "")],
    ["Training data (declared)", first.training],
    ["Weights (declared)", record.method.weights || "none"], ["Digest of the weights", record.method.weights_digest || "–"],
    ["Options", pairs(record.method.options) || "none"],
    ["Split, limit, samples, seed", [record.split, record.limit || "all", record.samples, record.seed].join(", ")],
    ["Device, threads", `${record.device}, ${record.threads}`], ["Packages", pairs(record.packages)],
    ["Protocol", `version ${record.protocol_version}, ${record.protocol_digest}`], ["prbench", record.prbench_version],
    ...record.tables.flatMap((table) => [[`${table.dataset}: identity digest`, table.identity_digest], [`${table.dataset}: content digest`, table.content_digest]]),
    ...(first.submission ? [["Submission", first.submission]] : []),
  ];
  document.getElementById("provenance").append(...facts.map(([name, value]) => make("div", {}, make("dt", { text: name }), make("dd", { text: String(value) }))));

  // All scores of one dataset and what it cost, as a table.
  const COSTS = { seconds: "seconds a motion", processor_seconds: "processor seconds a motion", network_passes: "network passes a motion (declared)",
    memory_mebibytes: "MiB of memory", parameters: "parameters (declared)" };
  const scoresOf = ({ row, title }) => {
    const rows = row.summary.metrics.map((metric) => {
      const shown = (value) => (value === null ? "–" : (value * scale(metric)).toFixed(2));
      const hidden = row.says_nothing.includes(metric.metric);
      const cells = [hidden ? "–" : shown(metric.mean) + unitOf(metric), hidden || metric.low === null ? "–" : `[${shown(metric.low)}, ${shown(metric.high)}]`,
        metric.interval, metric.sequences, metric.recordings, [...metric.marks, ...Object.entries(metric.flags).map(([name, count]) => `${name} ${count}`)].join(", ")];
      return make("tr", {}, make("th", { scope: "row", text: metric.title }), ...cells.map((text) => make("td", { text: String(text) })));
    });
    const heads = ["Metric", "Mean", "95 % interval", "Interval by", "Sequences", "Recordings", "Remarks"].map((text) => make("th", { scope: "col", text }));
    const cost = Object.entries(COSTS).filter(([key]) => row.cost[key] !== null).map(([key, words]) => `${Number(row.cost[key].toPrecision(4))} ${words}`);
    const doubt = row.unverified_cost ? ` cost.json is not believed: ${row.unverified_cost}` : "";
    return make("details", {}, make("summary", { text: "All scores, and the cost" }),
      make("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": `Scores: ${title}` },
        make("table", {}, make("caption", { text: title }), make("thead", {}, make("tr", {}, ...heads)), make("tbody", {}, ...rows))),
      make("p", { text: `Cost on the run's own machine: ${cost.join(", ") || "not measured"}.${doubt}` }));
  };

  // One dot a recording, as large as it has sequences, in lanes so that none covers another.
  const strip = (part, metric) => {
    const recordings = part.spread[metric.metric] || [];
    const [mean, low, high] = [metric.mean, metric.low, metric.high].map((value) => (value === null ? null : value * scale(metric)));
    const rate = metric.unit === "rate";
    const width = 520;
    const most = Math.max(...recordings.map(([, , count]) => count), 1);
    const values = recordings.map(([, value]) => value);
    const range = rate ? [0, 100] : [Math.min(0, ...values), Math.max(...values, high || 0) * 1.05 || 1];
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
      + `${Math.max(...values).toFixed(2)}${unitOf(metric)}; mean over sequences ${mean === null ? "–" : mean.toFixed(2)}`;
    const svg = draw("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": words });
    for (const value of ticks(...range, 6)) {
      svg.append(draw("line", { class: "grid", x1: at(value), x2: at(value), y1: 8, y2: base + 6 }),
        draw("text", { class: "tick", x: at(value), y: height - 6, "text-anchor": "middle", text: `${value}` }));
    }
    for (const { name, value, count, x, r, lane } of dots) {
      svg.append(draw("circle", { class: "dot", cx: x, cy: base - 6 - lane * step, r },
        draw("title", { text: `${name}: ${value.toFixed(2)}${unitOf(metric)}, ${count} sequences` })));
    }
    if (mean !== null) {
      svg.append(draw("line", { class: "mean-line", x1: at(mean), x2: at(mean), y1: 10, y2: base + 4 }));
      if (low !== null) svg.append(draw("line", { class: "span", x1: at(low), x2: at(high), y1: base + 4, y2: base + 4 }));
    }
    return svg;
  };

  const spread = (part) => {
    const figure = make("figure", {});
    const metrics = part.row.summary.metrics.filter(({ metric }) => part.main.includes(metric));
    const select = make("select", {}, ...metrics.map(({ metric, title }) => make("option", { value: metric, text: title })));
    const place = make("div", {});
    const show = () => place.replaceChildren(strip(part, metrics.find(({ metric }) => metric === select.value)));
    select.addEventListener("input", show);
    figure.append(make("figcaption", {}, "Spread over recordings: ", make("label", {}, make("span", { class: "unseen", text: "Metric" }), select)),
      place, make("p", { class: "hint", text: "A dot is a recording, larger with more sequences; the line is the mean over sequences with its 95 % interval." }));
    show();
    return figure;
  };

  const timing = (part) => {
    const { edges, counts, already, never, text } = part.timing;
    const width = edges[1] - edges[0];
    const [start, end] = [edges[0], edges.at(-1)];
    const beside = [["from the start", already], ["never (no hit)", never]];
    const most = Math.max(...counts, already, never, 1);
    const total = 590;
    const height = 210;
    const base = height - 44;
    const wide = 390 / counts.length;
    const up = (count) => (count / most) * (base - 18);
    const svg = draw("svg", { viewBox: `0 0 ${total} ${height}`, role: "img", "aria-label": text });
    for (const value of ticks(0, most, 4).filter(Number.isInteger)) {
      svg.append(draw("line", { class: "grid", x1: 36, x2: total - 6, y1: base - up(value), y2: base - up(value) }),
        draw("text", { class: "tick", x: 30, y: base - up(value) + 4, "text-anchor": "end", text: String(value) }));
    }
    counts.forEach((count, i) => {
      const outside = i === 0 || i === counts.length - 1;
      const words = i === 0 ? `before ${start} s` : outside ? `after ${end} s` : `${edges[i - 1].toFixed(1)} to ${edges[i].toFixed(1)} s`;
      svg.append(draw("rect", { class: outside ? "bar-out" : "bar-in", x: 40 + i * wide + 0.5, width: wide - 1, y: base - up(count), height: up(count) },
        draw("title", { text: `${words}: ${count}` })));
    });
    const zero = 40 + wide * (1 - start / width);
    svg.append(draw("line", { class: "mean-line", x1: zero, x2: zero, y1: 8, y2: base }));
    svg.append(draw("text", { class: "tick", x: 40, y: base + 15, text: `before ${start}` }),
      draw("text", { class: "tick", x: 432, y: base + 15, "text-anchor": "end", text: `after +${end}` }));
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
    const shown = shownOf(part.table);
    const place = make("div", { class: "charts" }, spread(part), ...(part.timing ? [timing(part)] : []), failures(part));
    if (shown.length) place.append(make("p", { class: "wide" }, link(shown[0], shown[0].prime, `Look at ${shown.length} motions`)));
    document.getElementById("parts").append(make("section", { id: `table-${part.table}` }, make("h2", { text: part.title }), place, scoresOf(part)));
  }
  document.getElementById("compare").href += `#first=${encodeURIComponent(told.run)}`;

  const follow = () => {
    const id = address().get("sequence");
    const sequence = everything.find((each) => each.sequence_id === id);
    if (sequence) look(id, Number(address().get("t")) || 0);
  };
  follow();
})();
