// The timeline: prime, event, what the metrics saw, and the curves of head and wrist; it is the slider of time.
(function () {
  "use strict";

  const prbench = (window.prbench = window.prbench || {});
  const parts = (prbench.playerParts = prbench.playerParts || {});
  const { make, svg } = parts.elements;

  const AXIS = 32; // pixels: height of the seconds and of the marks' names
  const PLOT = 46;
  const LANE = 8;
  const GAP = 7;
  const NARROW = 560;
  const DASHES = ["", "7 3", "2 3", "9 3 2 3", "1 4", "12 4"]; // one a motion, so that curves differ without colour
  const CURVES = [
    { name: "head", title: "head ray to goal", limit: "prime_distance" },
    { name: "wrist", title: "wrist to goal", limit: "reach_distance" },
  ];
  const SPANS = [
    { name: "onTarget", title: "ray on target", pattern: "solid" },
    { name: "withinReach", title: "wrist in reach", pattern: "hatch" },
    { name: "sliding", title: "foot slides", pattern: "zigzag" },
  ];
  let instances = 0;

  const centimetres = (metres) => (metres < 0.995 ? `${Math.round(100 * metres)} cm` : `${metres.toFixed(2)} m`);

  /** Timeline in an element; `onSeek(seconds)` is called while the user drags. */
  class Timeline {
    constructor(element, { onSeek }) {
      this.element = element;
      this.onSeek = onSeek;
      this._name = `prp-${(instances += 1)}`;
      this.picture = svg("svg", { "aria-hidden": "true" });
      this.head = make("div", { class: "prp-playhead", "aria-hidden": "true" });
      this.slider = make(
        "div",
        {
          class: "prp-slider",
          role: "slider",
          tabindex: 0,
          "aria-label": "Time",
          "aria-valuemin": 0,
          "aria-valuemax": 0,
          "aria-valuenow": 0,
        },
        this.picture,
        this.head,
      );
      element.append(this.slider);
      this.slider.addEventListener("pointerdown", (event) => this._press(event));
      this.slider.addEventListener("pointermove", (event) => {
        if (this._held === event.pointerId) this._seekTo(event);
      });
      for (const end of ["pointerup", "pointercancel"]) {
        this.slider.addEventListener(end, () => {
          this._held = null;
        });
      }
      this._observer = new ResizeObserver(() => this.draw());
      this._observer.observe(element);
    }

    _press(event) {
      if (event.button !== 0) return;
      this._held = event.pointerId;
      this.slider.setPointerCapture(event.pointerId);
      this.slider.focus({ preventScroll: true });
      event.preventDefault();
      this._seekTo(event);
    }

    _seekTo(event) {
      if (!this.sequence) return;
      const x = event.clientX - this.slider.getBoundingClientRect().left;
      this.onSeek(((x - this._left) / (this._right - this._left)) * this.sequence.duration);
    }

    /** Show a sequence; `motions` are those on the stage: {motion, number, colour}. */
    show(sequence, motions) {
      this.sequence = sequence;
      this.motions = motions;
      this.slider.setAttribute("aria-valuemax", sequence.duration.toFixed(2));
      this._drawn = null;
      this.draw();
      this.setTime(this.time || 0);
    }

    /** Show nothing. */
    clear() {
      this.sequence = null;
      this.picture.replaceChildren();
      this.head.style.height = "0";
    }

    setTime(time, words = "") {
      this.time = time;
      if (!this.sequence || !this._right) return;
      const share = this.sequence.duration > 0 ? time / this.sequence.duration : 0;
      this.head.style.transform = `translateX(${this._left + share * (this._right - this._left)}px)`;
      this.slider.setAttribute("aria-valuenow", time.toFixed(2));
      this.slider.setAttribute("aria-valuetext", words || `${time.toFixed(2)} seconds`);
    }

    /** Draw everything anew if the width or what is shown has changed. */
    draw() {
      const width = Math.floor(this.element.clientWidth);
      if (!this.sequence || !width || this._drawn === width) return;
      this._drawn = width;
      const narrow = width < NARROW;
      this._left = narrow ? 10 : 118;
      this._right = width - (narrow ? 12 : 16);
      const rows = [this._patterns()];
      let y = AXIS;
      const hasCurves = this.motions.some(({ motion }) => motion.head || motion.wrist);
      const area = svg("g", {});
      rows.push(area);
      if (hasCurves) {
        for (const curve of CURVES) {
          y += narrow ? 13 : 4;
          rows.push(this._curve(curve, y, narrow));
          y += PLOT + GAP;
        }
      }
      // Without a goal nothing is on target or in reach, but a foot may slide.
      for (const kind of hasCurves ? SPANS : SPANS.slice(2)) {
        y += narrow ? 12 : 0;
        rows.push(this._spans(kind, y, narrow));
        y += Math.max(this.motions.length * (LANE + 2), 12) + GAP;
      }
      area.append(...this._background(y - GAP / 2));
      rows.push(this._marks(y - GAP / 2));
      this.picture.setAttribute("width", width);
      this.picture.setAttribute("height", y);
      this.picture.setAttribute("viewBox", `0 0 ${width} ${y}`);
      this.picture.replaceChildren(...rows);
      this.head.style.height = `${y - 14}px`;
      this.setTime(this.time || 0, this.slider.getAttribute("aria-valuetext"));
    }

    _x(time) {
      const share = this.sequence.duration > 0 ? time / this.sequence.duration : 0;
      return this._left + share * (this._right - this._left);
    }

    _ofFrame(frame) {
      return this._x(Math.min(Math.max(frame / this.sequence.fps, 0), this.sequence.duration));
    }

    /** Return the patterns with which spans are filled: hatches and a zigzag, one a motion for its colour. */
    _patterns() {
      const list = svg("defs", {});
      for (const { number, colour } of this.motions) {
        list.append(
          svg(
            "pattern",
            {
              id: `${this._name}-hatch-${number}`,
              width: 5,
              height: 5,
              patternUnits: "userSpaceOnUse",
              patternTransform: "rotate(45)",
            },
            svg("rect", { width: 2.6, height: 5, fill: colour }),
          ),
          svg(
            "pattern",
            { id: `${this._name}-zigzag-${number}`, width: 8, height: LANE, patternUnits: "userSpaceOnUse" },
            svg("path", {
              d: `M0 ${LANE - 1.5}L4 1.500L8 ${LANE - 1.5}`,
              fill: "none",
              stroke: colour,
              "stroke-width": 1.8,
            }),
          ),
        );
      }
      return list;
    }

    /** Return seconds, the metric's window and the ground of the timeline. */
    _background(height) {
      const { duration, limits } = this.sequence;
      const list = [];
      const window_ = limits.window || [];
      if (window_.length === 2) {
        const from = this._ofFrame(window_[0] - 0.5);
        const to = this._ofFrame(window_[1] + 0.5);
        list.push(
          svg("rect", {
            class: "prp-window",
            x: from,
            y: AXIS - 3,
            width: Math.max(to - from, 1),
            height: height - AXIS + 3,
          }),
        );
      }
      const pixelsASecond = (this._right - this._left) / Math.max(duration, 1e-6);
      const step = [0.1, 0.25, 0.5, 1, 2, 5, 10].find((seconds) => seconds * pixelsASecond >= 44) || 20;
      for (let tick = 0; tick <= duration + 1e-6; tick += step) {
        const x = this._x(tick);
        list.push(svg("line", { class: "prp-tick", x1: x, x2: x, y1: AXIS - 3, y2: height }));
        const far = [this.sequence.primeTime, this.sequence.eventTime].every((mark) => Math.abs(this._x(mark) - x) > 1);
        list.push(
          svg(
            "text",
            { class: "prp-second", x, y: AXIS - 7, "text-anchor": "middle" },
            far || step >= 1 ? `${Number(tick.toFixed(2))}` : "",
          ),
        );
      }
      list.push(svg("text", { class: "prp-second", x: 4, y: AXIS - 7 }, this._left > 50 ? "seconds" : ""));
      return list;
    }

    /** Return the marks of prime and event with their names. */
    _marks(height) {
      const { primeTime, eventTime, action } = this.sequence;
      const group = svg("g", {});
      const mark = (time, name, shape) => {
        const x = this._x(Math.min(time, this.sequence.duration));
        const anchor = x > this._right - 70 ? "end" : x < this._left + 30 ? "start" : "middle";
        group.append(
          svg("line", { class: "prp-mark", x1: x, x2: x, y1: 14, y2: height }),
          svg("path", { class: "prp-mark-head", d: shape, transform: `translate(${x} 16)` }),
          svg("text", { class: "prp-mark-name", x, y: 10, "text-anchor": anchor }, `${name} ${time.toFixed(2)} s`),
        );
      };
      const close = Math.abs(this._x(primeTime) - this._x(eventTime)) < 150;
      if (parts.reading.hasPrime(this.sequence)) mark(primeTime, "prime", "M0 5L-5 -1L5 -1Z");
      mark(eventTime, close ? action.slice(0, 4) : action || "event", "M-4 -2H4V4H-4Z");
      return group;
    }

    /** Return the plot of one distance: a curve a motion, and the limit of the metric. */
    _curve({ name, title, limit }, top, narrow) {
      const limitValue = this.sequence.limits[limit];
      const values = this.motions.map(({ motion }) => motion[name]);
      const largest = Math.max(...values.map((column) => (column ? column.reduce((a, b) => Math.max(a, b), 0) : 0)));
      const ceiling = Math.min(Math.max(largest, 2 * (limitValue || 0.1)), 1.2);
      const y = (metres) => top + PLOT - (Math.min(metres, ceiling) / ceiling) * PLOT;
      const group = svg("g", {});
      group.append(
        svg("rect", { class: "prp-plot", x: this._left, y: top, width: this._right - this._left, height: PLOT }),
      );
      if (limitValue) {
        const line = y(limitValue);
        group.append(
          svg("rect", {
            class: "prp-good",
            x: this._left,
            y: line,
            width: this._right - this._left,
            height: top + PLOT - line,
          }),
          svg("line", { class: "prp-limit", x1: this._left, x2: this._right, y1: line, y2: line }),
        );
      }
      this.motions.forEach(({ number, colour }, index) => {
        const column = values[index];
        if (!column) return;
        const points = [];
        for (let frame = 0; frame < column.length; frame += 1)
          points.push(`${this._ofFrame(frame).toFixed(1)} ${y(column[frame]).toFixed(1)}`);
        group.append(
          svg("path", {
            d: `M${points.join("L")}`,
            fill: "none",
            stroke: colour,
            "stroke-width": 2,
            "stroke-linejoin": "round",
            "stroke-dasharray": DASHES[number % DASHES.length],
          }),
        );
      });
      if (narrow) {
        group.append(
          svg(
            "text",
            { class: "prp-row", x: this._left, y: top - 3 },
            `${title}, limit ${centimetres(limitValue || 0)}, top ${centimetres(ceiling)}`,
          ),
        );
      } else {
        const lines = [title, limitValue ? `limit ${centimetres(limitValue)}` : "", `0 to ${centimetres(ceiling)}`];
        lines.forEach((line, row) => {
          group.append(svg("text", { class: row ? "prp-second" : "prp-row", x: 4, y: top + 11 + 15 * row }, line));
        });
      }
      return group;
    }

    /** Return the spans of one kind, a lane a motion. */
    _spans({ name, title, pattern }, top, narrow) {
      const group = svg("g", {});
      const height = this.motions.length * (LANE + 2);
      if (narrow) group.append(svg("text", { class: "prp-row", x: this._left, y: top - 3 }, title));
      else group.append(svg("text", { class: "prp-row", x: 4, y: top + height / 2 + 4 }, title));
      this.motions.forEach(({ motion, number, colour }, lane) => {
        const y = top + lane * (LANE + 2);
        group.append(
          svg("rect", { class: "prp-lane", x: this._left, y, width: this._right - this._left, height: LANE, rx: 2 }),
        );
        if (!narrow && this.motions.length > 1)
          group.append(
            svg(
              "text",
              { class: "prp-number", x: this._left - 5, y: y + LANE - 0.5, "text-anchor": "end" },
              String(number + 1),
            ),
          );
        for (const [first, last] of motion[name]) {
          const from = this._ofFrame(first - 0.5);
          const width = Math.max(this._ofFrame(last + 0.5) - from, 2);
          const fill = pattern === "solid" ? colour : `url(#${this._name}-${pattern}-${number})`;
          group.append(
            svg("rect", {
              x: from,
              y,
              width,
              height: LANE,
              rx: pattern === "solid" ? 2 : 0,
              fill,
              "data-span": `${name} ${number}`,
            }),
          );
          if (pattern !== "solid")
            group.append(
              svg("rect", { x: from, y, width, height: LANE, fill: "none", stroke: colour, "stroke-width": 1 }),
            );
        }
      });
      return group;
    }

    /** Return the times to which one jumps: prime, event, and the start of every span, in order. */
    stops() {
      const { primeTime, eventTime, fps, action } = this.sequence;
      const list = [{ time: eventTime, words: action || "event" }];
      if (parts.reading.hasPrime(this.sequence)) list.push({ time: primeTime, words: "prime" });
      for (const { motion } of this.motions) {
        for (const { name, title } of SPANS) {
          for (const [first, last] of motion[name]) {
            const words = `${motion.label}: ${title} from ${(first / fps).toFixed(2)} to ${(last / fps).toFixed(2)} s`;
            list.push({ time: first / fps, words });
          }
        }
      }
      return list.sort((a, b) => a.time - b.time);
    }

    dispose() {
      this._observer.disconnect();
    }
  }

  parts.timeline = { Timeline, centimetres };
})();
