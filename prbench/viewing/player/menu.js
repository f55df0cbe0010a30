// The menu of sequences: search by words, filter by a failed metric, worst first.
(function () {
  "use strict";

  const prbench = (window.prbench = window.prbench || {});
  const parts = (prbench.playerParts = prbench.playerParts || {});
  const { make } = parts.elements;

  const PAGE = 100; // sequences that are listed at first; more on demand
  let instances = 0;

  /** Return a number that is larger for a worse text such as "43 cm" or "1.20 m"; 0 where it holds no length. */
  function lengthIn(text) {
    const found = /(-?[\d.]+)\s*(cm|mm|m)\b/.exec(text || "");
    if (!found) return 0;
    return Number(found[1]) * { m: 1, cm: 0.01, mm: 0.001 }[found[2]];
  }

  /** Return the motions of an entry that are judged: those of methods, or all where only recorded ones are there. */
  function judged(entry, label) {
    const all = entry.motions || [];
    if (label) return all.filter((motion) => motion.label === label);
    const methods = all.filter((motion) => motion.kind !== "recorded" && motion.label !== "ground truth");
    return methods.length ? methods : all;
  }

  /**
   * Return how bad an entry is, for sorting: failures first, then lengths.
   *
   * With a metric, the entries that fail it come first, the ones with its largest length before others.
   */
  function badness(entry, label, metric) {
    let failures = 0;
    let length = 0;
    for (const motion of judged(entry, label)) {
      for (const score of motion.scores || []) {
        if (score.good === false) failures += 1;
        if (score.good === false && score.title === metric) failures += 100;
        length += score.value === undefined ? lengthIn(score.text) : Number(score.value) || 0;
      }
    }
    return failures + Math.min(length, 99) / 100;
  }

  const fails = (entry, label, metric) =>
    judged(entry, label).some((motion) =>
      (motion.scores || []).some((score) => score.title === metric && score.good === false),
    );

  /** Menu in an element; `onChoose(sequence_id)` is called when the user picks one. */
  class Menu {
    constructor(element, entries, { onChoose }) {
      this.entries = entries;
      this.onChoose = onChoose;
      this.limit = PAGE;
      const name = `prp-menu-${(instances += 1)}`;
      const again = () => {
        this.limit = PAGE;
        this.list();
      };
      this.search = make("input", {
        type: "search",
        id: `${name}-search`,
        placeholder: "words of id or title",
        oninput: again,
        autocomplete: "off",
        spellcheck: "false",
      });
      this.metric = make("select", {
        id: `${name}-metric`,
        onchange: () => {
          if (this.metric.value) this.order.value = "worst";
          again();
        },
      });
      this.whose = make("select", {
        id: `${name}-whose`,
        onchange: () => {
          this._fillMetrics();
          again();
        },
      });
      this.order = make(
        "select",
        { id: `${name}-order`, onchange: again },
        make("option", { value: "given" }, "as given"),
        make("option", { value: "worst" }, "worst first"),
      );
      const labels = [...new Set(entries.flatMap((entry) => (entry.motions || []).map((motion) => motion.label)))];
      this.whose.append(
        make("option", { value: "" }, "all methods"),
        ...labels.map((label) => make("option", { value: label }, label)),
      );
      this._fillMetrics();
      this.count = make("p", { class: "prp-count", role: "status" });
      this.items = make("ul", { class: "prp-items" });
      this.more = make(
        "button",
        {
          type: "button",
          class: "prp-more",
          onclick: () => {
            this.limit += 4 * PAGE;
            this.list();
          },
        },
        "Show more",
      );
      const field = (label, control) =>
        make("div", { class: "prp-field" }, make("label", { for: control.id }, label), control);
      element.append(
        field("Search", this.search),
        make(
          "div",
          { class: "prp-fields" },
          field("Failed", this.metric),
          labels.length > 1 ? field("Of", this.whose) : null,
          field("Order", this.order),
        ),
        this.count,
        this.items,
        this.more,
      );
      this.items.addEventListener("keydown", (event) => this._walk(event));
      this.search.addEventListener("keydown", (event) => {
        if (event.key === "ArrowDown") this._focusItem(0, event);
        if (event.key === "Enter" && this.found.length) this.onChoose(this.found[0].sequence_id);
      });
      this.list();
    }

    _fillMetrics() {
      const before = this.metric.value;
      const label = this.whose.value;
      const counts = new Map();
      for (const entry of this.entries) {
        const titles = new Set();
        for (const motion of judged(entry, label)) {
          for (const score of motion.scores || []) if (score.good === false) titles.add(score.title);
        }
        for (const title of titles) counts.set(title, (counts.get(title) || 0) + 1);
      }
      this.metric.replaceChildren(
        make("option", { value: "" }, "any or none"),
        ...[...counts].map(([title, count]) => make("option", { value: title }, `${title} (${count})`)),
      );
      this.metric.value = counts.has(before) ? before : "";
    }

    _walk(event) {
      const buttons = [...this.items.querySelectorAll("button")];
      const here = buttons.indexOf(document.activeElement);
      const steps = { ArrowDown: here + 1, ArrowUp: here - 1, Home: 0, End: buttons.length - 1 };
      if (!(event.key in steps)) return;
      if (steps[event.key] < 0) {
        this.search.focus();
        event.preventDefault();
        event.stopPropagation();
      } else this._focusItem(steps[event.key], event);
    }

    _focusItem(number, event) {
      const button = this.items.querySelectorAll("button")[number];
      event.preventDefault();
      event.stopPropagation();
      if (button) button.focus();
    }

    /** Return the entries that search and filter leave, in their order. */
    get found() {
      const words = this.search.value.toLowerCase().split(/\s+/).filter(Boolean);
      const label = this.whose.value;
      const metric = this.metric.value;
      const list = this.entries.filter((entry) => {
        const text = `${entry.sequence_id} ${entry.dataset} ${entry.title}`.toLowerCase();
        return words.every((word) => text.includes(word)) && (!metric || fails(entry, label, metric));
      });
      if (this.order.value !== "worst") return list;
      const order = new Map(list.map((entry) => [entry, badness(entry, label, metric)]));
      return list.sort((a, b) => order.get(b) - order.get(a));
    }

    list() {
      const found = this.found;
      const label = this.whose.value;
      this.count.textContent = `${found.length} of ${this.entries.length} sequences`;
      const row = (entry) => {
        const cells = judged(entry, label).map((motion) => this._verdicts(motion, judged(entry, label).length > 1));
        return make(
          "li",
          {},
          make(
            "button",
            {
              type: "button",
              "data-id": entry.sequence_id,
              "aria-current": entry.sequence_id === this.current ? "true" : null,
              onclick: () => this.onChoose(entry.sequence_id),
            },
            make("span", { class: "prp-item-title" }, entry.title || entry.sequence_id),
            make("span", { class: "prp-item-id" }, make("bdi", {}, entry.sequence_id)),
            ...cells,
          ),
        );
      };
      this.items.replaceChildren(...found.slice(0, this.limit).map(row));
      this.more.hidden = found.length <= this.limit;
      this.more.textContent = `Show more (${found.length - this.limit} left)`;
    }

    /** Return the verdicts of one motion in a line: a hook or a cross before each rate's title. */
    _verdicts(motion, named) {
      const rates = (motion.scores || []).filter((score) => score.good !== null && score.good !== undefined);
      if (!rates.length) return null;
      const words = rates.map((score) =>
        make(
          "span",
          { class: score.good ? "prp-pass" : "prp-fail" },
          `${score.good ? "✓" : "✗"} ${score.title.replace(/ Success$/, "")}`,
        ),
      );
      return make("span", { class: "prp-verdicts" }, named ? make("span", {}, `${motion.label}:`) : null, ...words);
    }

    /** Mark the sequence that is shown. */
    mark(id) {
      this.current = id;
      for (const button of this.items.querySelectorAll("button")) {
        if (button.dataset.id === id) button.setAttribute("aria-current", "true");
        else button.removeAttribute("aria-current");
      }
    }

    /** Return the id of the sequence `step` places after the current one in the list, or null at its end. */
    neighbour(step) {
      const ids = this.found.map((entry) => entry.sequence_id);
      return ids[ids.indexOf(this.current) + step] || null;
    }
  }

  parts.menu = { Menu };
})();
