"use strict";
// The page of all tables: choose one, sort, filter, draw intervals as bars and methods as points. Every number and
// every group was computed in Python and stands in the tables; here they are only read.
(() => {
  const { make, draw, ticks, badges } = window.prbench.site;
  const sections = [...document.querySelectorAll("#boards section.table")];
  const form = document.getElementById("filters");
  const SHAPES = { none: "circle", text: "square", "goal-pose": "triangle", "goal-loc": "diamond", control: "cross" };
  const COSTS = ["processor_seconds", "network_passes", "memory_mebibytes", "parameters"];

  // The tables stand in the page as every export prints them. Words on a row move into the cell of its method, costs but
  // the seconds to the page of the run, and the group of a row gets a column.
  const pages = new Map(); // of runs, by what their rows say
  const laidOut = (section) => {
    const heads = [...section.querySelectorAll("thead th")];
    const place = Object.fromEntries(heads.map((head, i) => [head.dataset.key, i]));
    const kept = heads.filter(({ dataset }) => dataset.text === "false" && !COSTS.includes(dataset.key));
    const rows = [...section.querySelectorAll("tbody tr")].map((element, order) => {
      const cells = [...element.cells];
      const word = (key) => (key in place ? cells[place[key]].textContent : element.dataset[key] || "");
      const variant = word("variant").replace(/(^|; )unverified( \(cost\))?/g, "");
      const open = element.dataset.status ? element.dataset.status === "unverified" : word("variant").includes("unverified");
      const same = [word("condition"), word("method").split(" ")[0], variant, word("kind")].join("|");
      if (element.dataset.run) pages.set(same, element.dataset);
      const { run, control: marked } = pages.get(same) || {};
      const control = Boolean(marked) || word("condition") === "control";
      const name = make(run ? "a" : "span", { href: run && `runs/${run}.html`, text: word("method") });
      const missing = word("missing") ? `lacks ${word("missing")}` : "";
      const group = make("td", { class: "group" });
      const title = make("th", { scope: "row" }, name,
        make("span", { class: "badges" }, ...badges({ control, open, why: open ? word("verified") : word("verified") || null })),
        make("span", { class: "variant", text: [variant, missing].filter(Boolean).join("; ") }));
      const numbers = kept.map(({ dataset }) => {
        const cell = cells[place[dataset.key]];
        const [, mean, interval, mark] = cell.textContent.match(/^(\S*)(?: (\[[^\]]*\]))?(.*)$/);
        const best = Boolean(cell.querySelector("strong"));
        cell.className = "number";
        // The rank of a mean in parentheses stands in the column of groups.
        cell.replaceChildren(make(best ? "strong" : "span", { text: mean + mark.replace(/ \(\d+\)/, "") }));
        if (interval) cell.append(" ", make("span", { class: "interval", text: interval }));
        return cell;
      });
      element.replaceChildren(group, title, cells[place.condition], ...numbers);
      return {
        element, order, name, cells: element.cells, condition: control ? "control" : word("condition"),
        status: open ? "unverified" : "verified", training: word("training"), split: element.dataset.split || "",
        text: title.textContent.toLowerCase(),
      };
    });
    const group = make("th", { scope: "col", "data-key": "group", text: "Group" });
    heads[place.method].textContent = "Method";
    heads[place.condition].textContent = "Given";
    for (const head of kept) head.className = "number";
    if ("seconds" in place) {
      const head = heads[place.seconds];
      Object.assign(head.dataset, { unit: "s", better: "lower" });
      head.textContent = "Seconds a motion ↓";
    }
    section.querySelector("thead tr").replaceChildren(group, heads[place.method], heads[place.condition], ...kept);
    const shown = [...section.querySelectorAll("thead th")];
    const column = Object.fromEntries(shown.map((head, i) => [head.dataset.key, i]));
    const metrics = kept.map(({ dataset }) => dataset.key).filter((key) => key !== "seconds");
    const ranked = metrics.filter((key) => rows.some((row) => row.cells[column[key]].dataset.rank));
    return {
      section, heads: shown, rows, column, metrics, ranked: new Set(ranked), first: ranked[0] || metrics[0],
      dataset: section.dataset.dataset || "all", split: rows.length ? rows[0].split : "", body: section.querySelector("tbody"),
    };
  };
  // Means over datasets come first, but their rows find the pages of runs through those of the datasets.
  const ofDatasets = sections.filter((section) => section.dataset.dataset).map(laidOut);
  const tables = [...sections.filter((section) => !section.dataset.dataset).map(laidOut), ...ofDatasets];
  document.getElementById("boards").prepend(...tables.map(({ section }) => section));
  const number = (row, place) => {
    const text = row.cells[place].dataset.value;
    return text === "" || text === undefined ? null : Number(text);
  };

  // --- bars: the interval and the mean of a cell, on the scale of its column ---
  const WIDTH = 84;
  for (const { heads, rows } of tables) {
    heads.forEach((head, place) => {
      if (head.dataset.text !== "false") return;
      const values = rows.flatMap((row) => {
        const { value, low, high } = row.cells[place].dataset;
        return [value, low, high].filter((each) => each).map(Number);
      });
      const rate = head.dataset.unit === "%";
      const low = rate ? 0 : Math.min(0, ...values);
      const high = rate ? 100 : Math.max(...values, 1e-9);
      const at = (value) => (2 + ((value - low) / (high - low)) * (WIDTH - 4)).toFixed(1);
      for (const row of rows) {
        const cell = row.cells[place];
        if (!cell.dataset.low) continue;
        const from = at(Number(cell.dataset.low));
        const to = at(Number(cell.dataset.high));
        cell.append(draw("svg", { class: "interval-bar", viewBox: `0 0 ${WIDTH} 8`, "aria-hidden": "true" },
          draw("line", { class: "track", x1: 2, x2: WIDTH - 2, y1: 4, y2: 4 }),
          draw("line", { class: "span", x1: from, x2: to, y1: 4, y2: 4 }),
          draw("circle", { class: "mean", cx: at(Number(cell.dataset.value)), cy: 4, r: 3 })));
      }
    });
  }

  // --- what is shown, kept in the address so that a link leads back to it ---
  const state = { dataset: "", split: "", group: "", status: "", training: "", text: "", without: "", sort: "", up: "" };
  const fields = ["dataset", "split", "group", "status", "training", "text"];
  const uniques = (values) => [...new Set(values)];
  const offer = (name, values, all) => {
    const select = form.elements[name];
    select.replaceChildren(...(all ? [make("option", { value: "", text: all })] : []),
      ...values.map((value) => make("option", { value, text: value })));
    select.parentElement.hidden = values.length < 2;
    state[name] = values.includes(state[name]) ? state[name] : all ? "" : values[0];
    select.value = state[name];
  };
  const conditions = uniques(tables.flatMap((table) => table.rows.map((row) => row.condition)));
  const shownTables = () => {
    const all = tables.filter(({ dataset }) => dataset === state.dataset);
    const ofSplit = all.filter(({ split }) => !state.split || split === state.split);
    return ofSplit.length ? ofSplit : all;
  };
  const without = () => new Set(state.without ? state.without.split(",") : []);

  // The metric whose groups are shown: that by which the table is sorted, if methods are ranked by it.
  const metricOf = (table) => (table.ranked.has(state.sort) ? state.sort : table.first);

  const titleOf = (head) => head.textContent.replace(/ [↑↓].*$/, "");
  const passes = (row) => !without().has(row.condition) && (!state.status || row.status === state.status)
    && (!state.training || row.training === state.training) && row.text.includes(state.text.toLowerCase());

  const show = () => {
    const chosen = shownTables();
    let kept = 0;
    let all = 0;
    for (const table of tables) {
      table.section.hidden = !chosen.includes(table);
      if (table.section.hidden) continue;
      const by = table.column[metricOf(table)];
      table.heads[table.column.group].querySelector(".by").textContent = titleOf(table.heads[by]);
      for (const row of table.rows) {
        row.group = row.cells[by].dataset.rank || "";
        row.cells[table.column.group].textContent = row.group || "–";
        row.shown = passes(row) && (!state.group || row.group === state.group);
        row.element.hidden = !row.shown;
        kept += row.shown;
        all += 1;
      }
      sort(table);
    }
    document.getElementById("count").textContent = `${kept} of ${all} rows`;
    window.prbench.site.setAddress(state);
    plotSoon();
  };

  const sort = (table) => {
    const key = state.sort in table.column ? state.sort : table.first;
    const place = table.column[key];
    const words = ["method", "condition", "group"].includes(key);
    const better = table.heads[place].dataset.better === "lower" ? 1 : -1;
    const sign = (words ? 1 : better) * (state.up ? -1 : 1);
    const value = (row) => {
      if (key === "group") return row.group ? Number(row.group) : Infinity;
      return words ? row.cells[place].textContent.toLowerCase() : number(row, place);
    };
    const rows = [...table.rows].sort((one, other) => {
      const [a, b] = [value(one), value(other)];
      if (a === b) return one.order - other.order;
      if (a === null || b === null) return a === null ? 1 : -1;
      return (a < b ? -1 : 1) * sign;
    });
    table.body.append(...rows.map((row) => row.element));
    table.heads.forEach((head, i) => {
      if (i === place) head.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
      else head.removeAttribute("aria-sort");
    });
  };

  for (const table of tables) {
    for (const head of table.heads) {
      const text = head.textContent;
      const key = head.dataset.key;
      const press = () => {
        const again = state.sort === key || (!state.sort && key === table.first);
        state.up = again && !state.up ? "1" : "";
        state.sort = key;
        show();
      };
      const by = key === "group" ? [make("span", { class: "by" })] : [];
      head.replaceChildren(make("button", { type: "button", onclick: press }, text, ...by));
    }
  }

  // --- points: Prime against Reach, and against seconds ---
  const shape = (kind, x, y, r) => {
    const at = (points) => points.map(([dx, dy]) => `${x + dx * r},${y + dy * r}`).join(" ");
    if (kind === "square") return draw("rect", { x: x - r, y: y - r, width: 2 * r, height: 2 * r });
    if (kind === "triangle") return draw("polygon", { points: at([[0, -1.2], [1.15, 0.9], [-1.15, 0.9]]) });
    if (kind === "diamond") return draw("polygon", { points: at([[0, -1.35], [1.35, 0], [0, 1.35], [-1.35, 0]]) });
    if (kind === "cross") {
      const arm = [[-0.4, -1.2], [0.4, -1.2], [0.4, -0.4], [1.2, -0.4], [1.2, 0.4], [0.4, 0.4], [0.4, 1.2], [-0.4, 1.2],
        [-0.4, 0.4], [-1.2, 0.4], [-1.2, -0.4], [-0.4, -0.4]];
      return draw("polygon", { points: at(arm) });
    }
    return draw("circle", { cx: x, cy: y, r });
  };
  const shapeOf = (condition) => SHAPES[condition] || "circle";

  const plot = (figure, table, xKey, yKey, logarithmic) => {
    const read = (row, key) => {
      const { value, low, high } = row.cells[table.column[key]].dataset;
      return value ? { value: Number(value), low: low ? Number(low) : null, high: high ? Number(high) : null } : null;
    };
    const title = (key) => titleOf(table.heads[table.column[key]]);
    const unit = (key) => table.heads[table.column[key]].dataset.unit;
    const points = table.rows.filter((row) => (table.section.hidden ? passes(row) : row.shown))
      .map((row) => ({ row, x: read(row, xKey), y: read(row, yKey) })).filter(({ x, y }) => x && y);
    const where = table.section.hidden ? `, ${table.dataset}` : "";
    const heading = `${title(yKey)} against ${title(xKey)}${where}`;
    const caption = make("figcaption", { text: heading });
    if (!points.length) {
      figure.replaceChildren(caption, make("p", { class: "hint", text: "None of the rows has both numbers." }));
      return;
    }
    const width = Math.max(figure.clientWidth, 280);
    const height = Math.round(Math.min(420, Math.max(300, width * 0.72)));
    const box = { left: 46, right: width - 12, top: 12, bottom: height - 40 };
    const range = (key, list) => {
      if (unit(key) === "%") return [0, 100];
      const values = list.flatMap((each) => [each.value, each.low, each.high]).filter((each) => each !== null);
      if (key !== xKey || !logarithmic) return [Math.min(0, ...values), Math.max(...values) * 1.05];
      const [low, high] = [Math.min(...values), Math.max(...values)];
      return [Math.log10(low) - 0.15, Math.log10(high) + 0.15];
    };
    const xs = range(xKey, points.map(({ x }) => x));
    const ys = range(yKey, points.map(({ y }) => y));
    const onX = (value) => {
      const placed = logarithmic ? Math.log10(value) : value;
      return box.left + ((placed - xs[0]) / (xs[1] - xs[0] || 1)) * (box.right - box.left);
    };
    const onY = (value) => box.bottom - ((value - ys[0]) / (ys[1] - ys[0] || 1)) * (box.bottom - box.top);
    const svg = draw("svg", { viewBox: `0 0 ${width} ${height}`, role: "group", "aria-label": heading });

    // Grid and axes.
    const decades = () => {
      const found = [];
      for (let power = Math.ceil(xs[0]); power <= Math.floor(xs[1]); power += 1) found.push(10 ** power);
      return found.length > 1 ? found : ticks(10 ** xs[0], 10 ** xs[1], 4).filter((value) => value > 0);
    };
    for (const value of logarithmic ? decades() : ticks(...xs, width < 420 ? 4 : 6)) {
      const x = onX(value);
      svg.append(draw("line", { class: "grid", x1: x, x2: x, y1: box.top, y2: box.bottom }),
        draw("text", { class: "tick", x, y: box.bottom + 16, "text-anchor": "middle", text: String(value) }));
    }
    for (const value of ticks(...ys, 5)) {
      const y = onY(value);
      svg.append(draw("line", { class: "grid", x1: box.left, x2: box.right, y1: y, y2: y }),
        draw("text", { class: "tick", x: box.left - 7, y: y + 4, "text-anchor": "end", text: String(value) }));
    }
    const named = (key) => `${title(key)}${unit(key) ? ` (${unit(key)})` : ""}`;
    svg.append(draw("text", { class: "axis", x: box.right, y: height - 6, "text-anchor": "end", text: `${named(xKey)} →` }),
      draw("text", { class: "axis", x: 12, y: box.top, "text-anchor": "end", transform: `rotate(-90 12 ${box.top})`,
        text: `${named(yKey)} →` }));

    // Points, best first, so that the labels of the best find a place.
    points.sort((one, other) => other.y.value - one.y.value);
    const taken = points.map(({ x, y }) => {
      const [px, py] = [onX(x.value), onY(y.value)];
      return { left: px - 6, right: px + 6, top: py - 6, bottom: py + 6 };
    });
    const free = (area) => area.left >= box.left && area.right <= width - 2 && area.top >= 2 && area.bottom <= box.bottom
      && taken.every((other) => area.right < other.left || area.left > other.right
        || area.bottom < other.top || area.top > other.bottom);
    const marks = [];
    const labels = [];
    for (const { row, x, y } of points) {
      const [px, py] = [onX(x.value), onY(y.value)];
      const full = row.name.textContent;
      const short = full.length > 22 ? `${full.slice(0, 21)}…` : full;
      const long = short.length * 6.3 + 4;
      let placed = null;
      for (const away of [10, 18, 30, 46, 64]) {
        for (const [dx, dy] of [[1, 0], [-1, 0], [0.8, -0.8], [0.8, 0.8], [-0.8, -0.8], [-0.8, 0.8], [0, -1], [0, 1]]) {
          const at = [px + dx * away, py + dy * away];
          const left = dx > 0 ? at[0] : dx < 0 ? at[0] - long : at[0] - long / 2;
          const area = { left, right: left + long, top: at[1] - 8, bottom: at[1] + 7 };
          if (!placed && free(area)) placed = { area, at, away };
        }
        if (placed) break;
      }
      const told = (key, { value, low, high }) => {
        const digits = unit(key) === "%" ? 1 : 3;
        const bounds = low === null ? "" : ` [${low.toFixed(digits)}, ${high.toFixed(digits)}]`;
        return `${title(key)} ${value.toFixed(digits)}${bounds}`;
      };
      const name = `${full}, ${row.condition}: ${told(yKey, y)}, ${told(xKey, x)}`;
      const mark = draw("a", { href: row.name.getAttribute("href"), class: `point ${shapeOf(row.condition)}`, "aria-label": name },
        draw("title", { text: name }));
      if (y.low !== null) mark.append(draw("line", { class: "bound", x1: px, x2: px, y1: onY(y.low), y2: onY(y.high) }));
      if (x.low !== null) mark.append(draw("line", { class: "bound", x1: onX(x.low), x2: onX(x.high), y1: py, y2: py }));
      mark.append(shape(shapeOf(row.condition), px, py, 5));
      const hot = (on) => row.element.classList.toggle("hot", on);
      mark.addEventListener("focus", () => hot(true));
      mark.addEventListener("blur", () => hot(false));
      mark.addEventListener("mouseenter", () => hot(true));
      mark.addEventListener("mouseleave", () => hot(false));
      marks.push(mark);
      if (!placed) {
        // Crowded: the name appears with the focus or the pointer, over whatever is below.
        const end = px > (box.left + box.right) / 2;
        mark.append(draw("text", { class: "label late", x: px + (end ? -9 : 9), y: py - 8, "text-anchor": end ? "end" : "start", text: short }));
        continue;
      }
      taken.push(placed.area);
      if (placed.away > 12) labels.push(draw("line", { class: "leader", x1: px, y1: py, x2: placed.at[0], y2: placed.at[1] }));
      labels.push(draw("text", { class: "label", x: placed.area.left + 2, y: placed.area.bottom - 3, text: short }));
    }
    svg.append(...labels, ...marks);
    figure.replaceChildren(caption, svg);
  };

  const plotAll = () => {
    const [table] = shownTables();
    if (!table) return;
    const y = table.metrics.includes("prime_success") ? "prime_success" : table.metrics[0];
    const x = table.metrics.includes("reach_success") ? "reach_success" : table.metrics[1];
    document.getElementById("plots").hidden = false;
    plot(document.getElementById("plot-rates"), table, x, y, false);
    // A mean over datasets has no seconds of its own: the first dataset stands in, and is named.
    const timed = "seconds" in table.column ? table : ofDatasets[0];
    plot(document.getElementById("plot-seconds"), timed, "seconds", y, true);
    const there = uniques(table.rows.filter((row) => row.shown).map((row) => row.condition));
    document.getElementById("legend").replaceChildren(...there.map((condition) => {
      const icon = draw("svg", { viewBox: "0 0 16 16", class: `point ${shapeOf(condition)}`, "aria-hidden": "true" }, shape(shapeOf(condition), 8, 8, 5));
      return make("li", {}, icon, condition);
    }));
    for (const part of document.querySelectorAll("#printed section.table")) {
      const own = state.dataset.replace(/^synthetic-/, "");
      part.hidden = state.dataset !== "all" && part.dataset.dataset !== own;
    }
  };
  let asked = 0;
  const plotSoon = () => {
    cancelAnimationFrame(asked);
    asked = requestAnimationFrame(plotAll);
  };

  // --- controls ---
  const choices = () => {
    offer("dataset", uniques(tables.map(({ dataset }) => dataset)), "");
    const here = tables.filter(({ dataset }) => dataset === state.dataset);
    offer("split", uniques(here.map(({ split }) => split)).filter(Boolean), "all");
    const groups = uniques(here.flatMap((table) => table.rows.flatMap((row) => [...row.cells].map((cell) => cell.dataset.rank || ""))));
    offer("group", groups.filter(Boolean).sort((one, other) => one - other), "all");
    for (const key of ["training", "status"]) offer(key, uniques(here.flatMap(({ rows }) => rows.map((row) => row[key]))), "all");
    form.elements.text.value = state.text;
    const hidden = without();
    document.getElementById("conditions").replaceChildren(...conditions.map((condition) => {
      const box = make("input", { type: "checkbox", value: condition });
      box.checked = !hidden.has(condition);
      const icon = draw("svg", { viewBox: "0 0 16 16", class: `point ${shapeOf(condition)}`, "aria-hidden": "true" }, shape(shapeOf(condition), 8, 8, 5));
      return make("label", {}, box, icon, condition);
    }));
  };
  const fromAddress = () => {
    const address = window.prbench.site.address();
    for (const key of Object.keys(state)) state[key] = address.get(key) || "";
    choices();
    show();
  };
  form.addEventListener("input", (event) => {
    const { name, value, type } = event.target;
    if (type === "checkbox") {
      const boxes = [...document.querySelectorAll("#conditions input")];
      state.without = boxes.filter((box) => !box.checked).map((box) => box.value).join(",");
    } else if (fields.includes(name)) state[name] = value;
    if (name === "dataset") choices();
    show();
  });
  form.addEventListener("submit", (event) => event.preventDefault());
  addEventListener("resize", plotSoon);
  addEventListener("hashchange", () => {
    // A link to a part of the page is no choice of rows.
    if (location.hash.includes("=")) fromAddress();
  });
  // Printed tables are long: each folds behind its title.
  for (const part of document.querySelectorAll("#printed section.table")) {
    const fold = make("details", {}, make("summary", { text: part.querySelector("h2").textContent }));
    part.querySelector("h2").remove();
    fold.append(...part.children);
    part.append(fold);
  }
  form.hidden = false;
  const first = location.hash;
  fromAddress();
  if (first && !first.includes("=")) {
    history.replaceState(null, "", first);
    const part = document.getElementById(first.slice(1));
    if (part) part.scrollIntoView();
  }
})();
