"use strict";
// Two runs side by side. Every difference, interval, p-value and sentence was computed in Python for the pair, in one
// order; the page shows the pair in that order, so that no sign is ever turned here.
(() => {
  const { make, draw, data, load, script, address, setAddress, openPlayer, closePlayer, arrivedAt } = window.prbench.site;
  const { runs, shown: withMotions } = data();
  const form = document.getElementById("pick");
  const answer = document.getElementById("answer");
  const result = document.getElementById("result");
  const place = new Map(runs.map(({ run }, i) => [run, i]));

  const bar = ({ numbers: [mean, low, high], better }, reach) => {
    const width = 150;
    const at = (value) => width / 2 + Math.max(-1, Math.min(1, value / reach)) * (width / 2 - 5);
    const svg = draw("svg", { class: `difference ${better || "open"}`, viewBox: `0 0 ${width} 16`, "aria-hidden": "true" },
      draw("line", { class: "zero", x1: width / 2, x2: width / 2, y1: 0, y2: 16 }));
    if (low !== null) svg.append(draw("line", { class: "span", x1: at(low), x2: at(high), y1: 8, y2: 8 }));
    svg.append(draw("circle", { class: "mean", cx: at(mean), cy: 8, r: 3.5 }));
    return svg;
  };

  const tableOf = (dataset, metrics, first, second) => {
    const words = { first: `${first.label} is better`, second: `${second.label} is better` };
    const rows = metrics.map((metric) => {
      // Rates share the scale of all rates; a length has its own.
      const [difference, interval, pValue, detectable] = metric.printed;
      const ends = metric.numbers.filter((each) => each !== null).map(Math.abs);
      const reach = difference.endsWith("points") ? 100 : Math.max(...ends, 1e-9) * 1.15;
      return make("tr", { class: metric.better || "open" },
        make("th", { scope: "row", text: metric.title }),
        make("td", { class: "number", text: difference }),
        make("td", {}, bar(metric, reach)),
        make("td", { class: "number", text: interval }),
        make("td", { class: "number", text: pValue }),
        make("td", { class: "number", text: detectable }),
        make("td", { class: "verdict", text: words[metric.better] || metric.conclusion }));
    });
    const heads = ["Metric", "Difference", "", "95 % interval", "p (Holm)", "Detectable", "Supported by the data"].map((text) =>
      (text ? make("th", { scope: "col", text }) : make("td", {})));
    const sentences = make("ul", { class: "sentences" }, ...metrics.map(({ sentence }) => make("li", { text: sentence })));
    return make("section", {},
      make("h2", { text: dataset }),
      make("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": `Differences on ${dataset}` },
        make("table", { class: "pairs" },
          make("caption", { text: `${first.label} minus ${second.label}, ${dataset}` }),
          make("thead", {}, make("tr", {}, ...heads)), make("tbody", {}, ...rows))),
      make("details", {}, make("summary", { text: "In sentences, to quote" }), sentences));
  };

  let shown = "";
  const show = async () => {
    let [one, other] = [form.elements.first.value, form.elements.second.value];
    if (place.get(one) > place.get(other)) [one, other] = [other, one];
    setAddress({ ...Object.fromEntries(address()), first: form.elements.first.value, second: form.elements.second.value });
    const first = runs[place.get(one)];
    const second = runs[place.get(other)];
    const asked = `${one} ${other}`;
    shown = asked;
    closePlayer();
    result.replaceChildren();
    const common = first.tables.filter((table) => second.tables.includes(table));
    if (one === other) return answer.replaceChildren("Choose two different runs.");
    if (!common.length) return answer.replaceChildren(`${first.label} and ${second.label} stand in no common table, so nothing compares them.`);
    const pairs = await load(`pairs/${one}.js`, `pairs/${one}`);
    if (shown !== asked) return undefined; // another pair was chosen meanwhile
    const metrics = (pairs || {})[other];
    if (!metrics) return answer.replaceChildren("This pair is not on this site.");
    const wins = (who) => metrics.filter(({ better }) => better === who).length;
    const words = (run, count) => `${run.label} is better in ${count}`;
    answer.replaceChildren(make("p", { class: "verdict-line", text: `Of ${metrics.length} comparisons ${words(first, wins("first"))}, `
      + `${words(second, wins("second"))}; in ${wins("")} the data support no difference.` }));
    const datasets = [...new Set(metrics.map(({ dataset }) => dataset))];
    result.append(...datasets.map((dataset) => tableOf(dataset, metrics.filter((metric) => metric.dataset === dataset), first, second)));

    // Sequences whose motions both runs show.
    for (const table of common.filter((each) => withMotions.includes(each))) await script(`motions/${table}.js`);
    if (shown !== asked) return undefined;
    const both = common.flatMap((table) => arrivedAt(table) || []).filter(({ runs: there }) => there[one] && there[other]);
    if (both.length) {
      const pair = [first, second].map(({ run, label }) => ({ key: run, label }));
      const open = (id, time) => openPlayer(both, pair, id, time);
      const id = address().get("sequence");
      const wanted = both.find((sequence) => sequence.sequence_id === id);
      if (wanted) open(id, Number(address().get("t")) || 0);
      else result.append(make("p", {}, make("button", { type: "button", class: "look", text: `Look at ${both.length} sequences of both side by side`,
        onclick: () => open(both[0].sequence_id, both[0].prime) })));
    }
    return undefined;
  };

  for (const name of ["first", "second"]) {
    form.elements[name].append(...runs.map(({ run, label }) => make("option", { value: run, text: label })));
  }
  const fromAddress = () => {
    const [one, other] = [address().get("first"), address().get("second")];
    form.elements.first.value = place.has(one) ? one : runs[0].run;
    const next = runs.find(({ run }) => run !== form.elements.first.value);
    form.elements.second.value = place.has(other) ? other : next ? next.run : runs[0].run;
    show();
  };
  form.addEventListener("input", show);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.hidden = false;
  if (runs.length) fromAddress();
})();
