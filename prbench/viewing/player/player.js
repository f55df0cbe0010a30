// The player: one element of a page with stage, timeline, scores, menu and controls.
//
// `prbench.player.mount(element, entries, options)` returns `{show, seek, destroy}`. An entry is a whole document, or
// what the menu needs of one (`sequence_id, dataset, title, motions`) with `load()`, a promise of the document.
(function () {
  "use strict";

  const prbench = (window.prbench = window.prbench || {});
  const parts = prbench.playerParts;
  const { make, button, swatch } = parts.elements;

  const SPEEDS = [0.1, 0.25, 0.5, 1, 1.5, 2];
  const VIEWS = [
    ["default", "3/4", "View from ahead and the side (1)"],
    ["side", "Side", "View from the side (2)"],
    ["front", "Front", "View from ahead (3)"],
    ["above", "Above", "View from above (4)"],
    ["eyes", "Eyes", "View through the head's eyes; again for the next motion (5)"],
  ];
  const LAYOUTS = [
    ["lanes", "Lanes", "Motions side by side on one floor (L)"],
    ["overlay", "Overlay", "Motions at one place, translucent (L)"],
    ["views", "Split", "Motions in pictures of their own with one camera (L)"],
  ];
  const LAYERS = [
    ["head", "head ray"],
    ["gaze", "gaze ray (dashed)"],
    ["paths", "paths of wrists and pelvis"],
    ["limits", "spheres of the limits"],
    ["objects", "objects"],
    ["scenery", "scene mesh"],
    ["labels", "names"],
  ];
  const KEYS = [
    ["Space", "play or pause"],
    ["← →", "one frame back or ahead; with Shift half a second"],
    ["Home End", "first or last frame"],
    ["P E", "jump to the prime, to the event"],
    ["N B", "next or previous mark: prime, event, starts of spans"],
    ["- +", "slower or faster"],
    ["R", "repeat at the end"],
    ["1 … 5", "view: three quarters, side, front, above, eyes"],
    ["W A S D", "turn the camera"],
    ["I O", "nearer, farther"],
    ["F", "camera follows the bodies"],
    ["L", "lanes, overlay, split"],
    ["X", "what is shown"],
    ["J K", "next or previous sequence of the list"],
    ["/", "search the sequences"],
    ["C", "copy a link to this moment"],
    ["G", "save a picture or a film"],
    ["T", "light or dark"],
    ["?", "this list; Esc closes it"],
  ];

  /** What stands in for the stage where the browser has no WebGL: everything else of the player stays usable. */
  class NoStage {
    constructor(element, reason) {
      this.element = element;
      element.append(
        make(
          "div",
          { class: "prp-missing", role: "note" },
          make("p", {}, make("strong", {}, "The bodies cannot be drawn: this browser offers no WebGL.")),
          make(
            "p",
            {},
            `Switch on hardware acceleration, or use another browser. Timeline, scores and distances work without it. (${reason})`,
          ),
        ),
      );
    }
  }
  for (const name of [
    "show",
    "clear",
    "choose",
    "setLayout",
    "setLayers",
    "setTheme",
    "setTime",
    "setFollow",
    "look",
    "orbit",
    "draw",
    "dispose",
    "invalidate",
  ]) {
    NoStage.prototype[name] = () => {};
  }

  /** Return text as it was before it was made part of an address; text that was not, as it is. */
  function decoded(text) {
    try {
      return decodeURIComponent(text);
    } catch {
      return text;
    }
  }

  /** Return the parts `name=value` of the page's address behind its hash, still encoded. */
  function hashParts() {
    return location.hash.replace(/^#/, "").split("&").filter(Boolean);
  }

  /** Return what the address of the page asks for: sequence, time, labels of motions. */
  function readHash() {
    const asked = Object.fromEntries(
      hashParts().map((part) => [part.split("=")[0], part.slice(part.indexOf("=") + 1)]),
    );
    const time = Number.parseFloat(asked.t);
    return {
      sequence: asked.sequence ? decoded(asked.sequence) : null,
      time: Number.isFinite(time) ? time : null,
      motions: asked.motions ? asked.motions.split(",").map(decoded) : null,
    };
  }

  class Player {
    constructor(element, entries, options) {
      this.root = element;
      this.entries = entries;
      this.options = options;
      this.time = 0;
      this.speed = 1;
      this.playing = false;
      this.repeat = false;
      this.labels = null; // of the chosen motions; null: all
      this.layout = "lanes";
      this.view = "default";
      this.follow = false;
      this.layers = {};
      this._listeners = [];
      this._token = 0;
      this.reducedMotion = matchMedia("(prefers-reduced-motion: reduce)").matches;
      this._build();
      this._listen();
      this._theme();
    }

    // ---------------------------------------------------------------------------------------------- the elements

    _build() {
      const { root, entries, options } = this;
      root.classList.add("prp");
      root.classList.toggle("prp-compact", Boolean(options.compact));
      // A landmark, such as main, keeps its role.
      if (root.tagName === "DIV") root.setAttribute("role", "group");
      if (root.tagName === "DIV") root.setAttribute("aria-label", "Motion player");
      // A page without a title of its own gets one.
      this.heading = make(document.querySelector("h1") ? "h2" : "h1", { class: "prp-title" });
      this.subtitle = make("p", { class: "prp-subtitle" });
      this.place = make("div", { class: "prp-stage", tabindex: -1 }); // a click into it brings the keys here
      this.tags = make("div", { class: "prp-tags", "aria-hidden": "true" });
      this.status = make("p", { class: "prp-status", role: "status" });
      this.live = make("p", { class: "prp-hidden", role: "status", "aria-live": "polite" });
      this.clock = make("span", { class: "prp-clock" });
      this.notice = make("p", { class: "prp-notice" });
      this.scores = make("div", { class: "prp-scores" });
      const timeline = make("div", { class: "prp-timeline" });
      this.nav = entries.length > 1 ? make("nav", { class: "prp-menu", "aria-label": "Sequences" }) : null;
      this.menuButton = this.nav
        ? make(
            "button",
            { type: "button", class: "prp-menu-button", "aria-expanded": "false", onclick: () => this._openMenu() },
            `Sequences (${entries.length})`,
          )
        : null;
      const top = make(
        "header",
        { class: "prp-top" },
        this.menuButton,
        make("div", { class: "prp-titles" }, this.heading, this.subtitle),
        make(
          "div",
          { class: "prp-tools" },
          button("Link", "Copy a link to this moment (C)", () => this._copy()),
          this._saveMenu(),
          this._layerMenu(),
          options.compact ? null : button("theme", "Light or dark (T)", () => this._switchTheme()),
          button("?", "Keys and help (?)", () => this._help(), { "aria-label": "Keys and help" }),
        ),
      );
      root.append(
        make(
          "div",
          { class: "prp-frame" },
          this.nav,
          make("div", { class: "prp-main" }, top, this.place, this._transport(), timeline, this.scores, this.notice),
        ),
        this.live,
      );
      try {
        if (typeof THREE === "undefined") throw new Error("three.js is missing from the page");
        this.stage = new parts.stage.Stage(this.place, {
          reducedMotion: this.reducedMotion,
          onDraw: (labels) => this._placeTags(labels),
        });
        this.stage.canvas.setAttribute("role", "img");
        this.stage.canvas.addEventListener("webglcontextlost", (event) => {
          event.preventDefault();
          this._say("The graphics card has dropped the picture; it comes back by itself, or reload the page.");
        });
        this.stage.canvas.addEventListener("webglcontextrestored", () => this.stage.invalidate());
      } catch (error) {
        // three.js has told the console why; the user is told here.
        this.stage = new NoStage(this.place, error.message);
      }
      this.place.append(this.tags, this.status, this._viewButtons());
      this.timeline = new parts.timeline.Timeline(timeline, { onSeek: (seconds) => this.seek(seconds) });
      if (this.nav) this.menu = new parts.menu.Menu(this.nav, entries, { onChoose: (id) => this._chosen(id) });
      this.dialog = make("dialog", { class: "prp-dialog", "aria-label": "Keys and help" });
      root.append(this.dialog);
    }

    _transport() {
      this.playButton = button("play", "Play (Space)", () => this.toggle(), { class: "prp-play" });
      this.repeatButton = button("loop", "Repeat at the end (R)", () => this._setRepeat(!this.repeat), {
        "aria-pressed": "false",
      });
      this.speedChoice = make(
        "select",
        {
          "aria-label": "Speed",
          title: "Speed (- +)",
          onchange: () => {
            this.speed = Number(this.speedChoice.value);
          },
        },
        ...SPEEDS.map((speed) => make("option", { value: speed, selected: speed === 1 }, `${speed}×`)),
      );
      return make(
        "div",
        { class: "prp-transport", role: "group", "aria-label": "Time" },
        button("previous", "Previous mark (B)", () => this._jump(-1)),
        button("back", "One frame back (←)", () => this._step(-1)),
        this.playButton,
        button("ahead", "One frame ahead (→)", () => this._step(1)),
        button("next", "Next mark (N)", () => this._jump(1)),
        this.repeatButton,
        this.speedChoice,
        make(
          "span",
          { class: "prp-jumps" },
          button("Prime", "Jump to the prime (P)", () => this._toPrime()),
          button("Event", "Jump to the event (E)", () => this._goTo(this.sequence.eventTime, "event")),
        ),
        this.clock,
      );
    }

    _viewButtons() {
      const choice = (list, act, current) =>
        list.map(([value, words, title]) =>
          button(words, title, () => act(value), { "data-value": value, "aria-pressed": String(value === current) }),
        );
      this.viewButtons = make(
        "div",
        { class: "prp-choice", role: "group", "aria-label": "View" },
        ...choice(VIEWS, (view) => this._look(view), "default"),
      );
      this.followButton = button("Follow", "Camera follows the bodies (F)", () => this._setFollow(!this.follow), {
        "aria-pressed": "false",
      });
      this.layoutButtons = make(
        "div",
        { class: "prp-choice", role: "group", "aria-label": "Arrangement" },
        ...choice(LAYOUTS, (layout) => this._setLayout(layout), "lanes"),
      );
      return make(
        "div",
        { class: "prp-views" },
        this.layoutButtons,
        this.viewButtons,
        make("div", { class: "prp-choice" }, this.followButton),
      );
    }

    /** Return a button that opens a small panel, with the panel. */
    _panel(words, title, ...children) {
      const inside = make("div", { class: "prp-panel" }, ...children);
      const details = make(
        "details",
        { class: "prp-details" },
        make("summary", { title, "aria-label": title }, words),
        inside,
      );
      details.addEventListener("keydown", (event) => {
        if (event.key !== "Escape" || !details.open) return;
        details.open = false;
        details.querySelector("summary").focus();
        event.stopPropagation();
      });
      return details;
    }

    _layerMenu() {
      const boxes = LAYERS.map(([name, words]) => {
        const box = make("input", {
          type: "checkbox",
          checked: true,
          onchange: () => {
            this.layers[name] = box.checked;
            this.stage.setLayers(this.layers);
          },
        });
        return make("label", {}, box, ` ${words}`);
      });
      this.layerPanel = this._panel("Show", "What is shown (X)", ...boxes);
      return this.layerPanel;
    }

    _saveMenu() {
      this.withNames = make("input", { type: "checkbox", checked: true });
      this.progress = make("progress", { max: 1, value: 0, "aria-label": "Recorded part of the film" });
      this.cancel = make(
        "button",
        { type: "button", onclick: () => this._recording && this._recording.cancel() },
        "Cancel",
      );
      this.filmRow = make("div", { class: "prp-film", hidden: true }, this.progress, this.cancel);
      this.filmButton = make("button", { type: "button", onclick: () => this._film() }, "Film (WebM, real time)");
      this.savePanel = this._panel(
        "Save",
        "Save a picture or a film (G)",
        make("button", { type: "button", onclick: () => this._picture("#ffffff") }, "Picture, white (PNG, 2×)"),
        make("button", { type: "button", onclick: () => this._picture(null) }, "Picture, transparent (PNG, 2×)"),
        make("label", {}, this.withNames, " names and title"),
        this.filmButton,
        this.filmRow,
      );
      return this.savePanel;
    }

    // ------------------------------------------------------------------------------------------------- listening

    _on(target, type, act, options) {
      target.addEventListener(type, act, options);
      this._listeners.push(() => target.removeEventListener(type, act, options));
    }

    _listen() {
      // Keys are heard wherever nothing else wants them; a compact player, one of many, hears those inside it only.
      this._on(this.options.compact ? this.root : document, "keydown", (event) => this._key(event));
      this._on(document, "pointerdown", (event) => {
        for (const panel of [this.savePanel, this.layerPanel]) if (!panel.contains(event.target)) panel.open = false;
      });
      if (!this.options.compact) {
        this._on(window, "hashchange", () => {
          const asked = readHash();
          if (location.hash === this._hash || !asked.sequence) return;
          this.labels = asked.motions || this.labels;
          this.show(asked.sequence, asked.time);
        });
      }
      const colours = matchMedia("(prefers-color-scheme: dark)");
      this._on(colours, "change", () => this._theme());
      this._themeWatch = new MutationObserver(() => this._theme());
      this._themeWatch.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
    }

    _key(event) {
      const target = event.target;
      const inside = this.root.contains(target);
      if (!inside && target !== document.body && target !== document.documentElement) return;
      if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented || this.dialog.open) return;
      if (/^(INPUT|SELECT|TEXTAREA)$/.test(target.tagName) && target.type !== "checkbox") {
        if (event.key === "Escape" && inside) target.blur();
        return;
      }
      const presses = event.key === " " || event.key === "Enter";
      if (presses && (/^(BUTTON|SUMMARY|A)$/.test(target.tagName) || target.type === "checkbox")) return;
      const act = this._action(event);
      if (!act) return;
      event.preventDefault();
      act();
    }

    /** Return what a key does, or undefined. */
    _action(event) {
      const step = event.shiftKey ? Math.round(0.5 * (this.sequence ? this.sequence.fps : 20)) : 1;
      const views = { 1: "default", 2: "side", 3: "front", 4: "above", 5: "eyes" };
      const table = {
        " ": () => this.toggle(),
        arrowleft: () => this._step(-step),
        arrowright: () => this._step(step),
        home: () => this._goTo(0, "start"),
        end: () => this._goTo(this.sequence.duration, "end"),
        p: () => this._toPrime(),
        e: () => this._goTo(this.sequence.eventTime, this.sequence.action || "event"),
        n: () => this._jump(1),
        b: () => this._jump(-1),
        "-": () => this._changeSpeed(-1),
        "+": () => this._changeSpeed(1),
        "=": () => this._changeSpeed(1),
        r: () => this._setRepeat(!this.repeat),
        f: () => this._setFollow(!this.follow),
        l: () =>
          this._setLayout(LAYOUTS[(LAYOUTS.findIndex(([name]) => name === this.layout) + 1) % LAYOUTS.length][0]),
        w: () => this.stage.orbit(0, -0.12),
        s: () => this.stage.orbit(0, 0.12),
        a: () => this.stage.orbit(-0.15, 0),
        d: () => this.stage.orbit(0.15, 0),
        i: () => this.stage.orbit(0, 0, 0.88),
        o: () => this.stage.orbit(0, 0, 1 / 0.88),
        j: () => this._neighbour(1),
        k: () => this._neighbour(-1),
        x: () => this._togglePanel(this.layerPanel),
        g: () => this._togglePanel(this.savePanel),
        c: () => this._copy(),
        t: () => this._switchTheme(),
        "/": () => this._search(),
        "?": () => this._help(),
      };
      if (views[event.key]) return () => this._look(views[event.key]);
      const always = ["/", "?", "t", "j", "k"];
      const key = event.key.toLowerCase();
      return this.sequence || always.includes(key) ? table[key] : undefined;
    }

    _togglePanel(panel) {
      panel.open = !panel.open;
      const first = panel.open
        ? panel.querySelector(".prp-panel button, .prp-panel input")
        : panel.querySelector("summary");
      if (first) first.focus();
    }

    // ---------------------------------------------------------------------------------------------- the sequence

    /** Show a sequence at a time in seconds; without a time, at its start. */
    async show(id, time = null) {
      const entry = this.entries.find((item) => item.sequence_id === id);
      const token = (this._token += 1);
      this.pause();
      if (!entry) {
        if (!this.sequence && this.entries.length) await this.show(this.entries[0].sequence_id, null);
        this._say(`This page has no sequence '${id}'. Choose one of the list.`);
        return;
      }
      this._say(entry.load ? "Loading the sequence …" : "");
      let sequence;
      try {
        const document_ = entry.load ? await entry.load() : entry;
        if (token !== this._token) return; // another one was chosen in the meantime
        sequence = parts.reading.read(document_);
      } catch (error) {
        if (token !== this._token) return;
        this._fail(entry, error);
        return;
      }
      this._say("");
      this.sequence = sequence;
      this.heading.textContent = sequence.title || sequence.id;
      this.subtitle.textContent = `${sequence.dataset} · ${sequence.id}`;
      this.notice.textContent = [this._what(sequence), sequence.notice].filter(Boolean).join(" ");
      this.root.classList.toggle("prp-single", sequence.motions.length < 2);
      this._fillScores();
      // Each motion has a room of its own where there is one; beside it the others would walk through walls.
      if (!this._choseLayout) this._arrange(sequence.mesh && this.stage.canvas ? "views" : "lanes");
      this.stage.show(sequence, this.chosen);
      this._describe();
      this._paintMotions();
      if (this.menu) this.menu.mark(sequence.id);
      this.seek(time === null ? 0 : time, true);
      this._announce(`${sequence.title || sequence.id}, ${sequence.duration.toFixed(1)} seconds.`);
    }

    /** Say what of the sequence is not there. */
    _what(sequence) {
      const missing = [];
      if (!sequence.goal) missing.push("The goal is not shown: it is unknown, or its dataset does not pass it on.");
      if (!sequence.motions.some((motion) => motion.kind === "recorded"))
        missing.push("The recorded motion is not on this page.");
      return missing.join(" ");
    }

    _fail(entry, error) {
      this.sequence = null;
      this.stage.clear();
      this.stage.invalidate();
      this.timeline.clear();
      this.scores.replaceChildren();
      this.clock.textContent = "";
      this.notice.textContent = "";
      this.heading.textContent = entry.title || entry.sequence_id;
      this.subtitle.textContent = `${entry.dataset} · ${entry.sequence_id}`;
      this._say(`The sequence cannot be shown. ${error && error.message ? error.message : error}`);
      if (this.menu) this.menu.mark(entry.sequence_id);
    }

    /** Labels of the motions on the stage. */
    get chosen() {
      const all = this.sequence.motions.map((motion) => motion.label);
      const wanted = this.labels ? all.filter((label) => this.labels.includes(label)) : all;
      return wanted.length ? wanted : all;
    }

    _chosen(id) {
      this._closeMenu();
      this.show(id).then(() => this._writeHash());
    }

    _neighbour(step) {
      if (!this.menu) return;
      const id = this.menu.neighbour(step);
      if (id) this.show(id).then(() => this._writeHash());
      else
        this._announce(step > 0 ? "This is the last sequence of the list." : "This is the first sequence of the list.");
    }

    /** Colours in which motions are drawn on page and stage, by their number. */
    _colours() {
      const dark = this.dark;
      return this.sequence.motions.map(({ colour }) =>
        typeof THREE === "undefined" ? colour : `#${parts.stage.paintOf(colour, dark).getHexString()}`,
      );
    }

    _paintMotions() {
      const colours = this._colours();
      const chosen = this.chosen;
      const shown = this.sequence.motions
        .map((motion, number) => ({ motion, number, colour: colours[number] }))
        .filter(({ motion }) => chosen.includes(motion.label));
      this.timeline.show(this.sequence, shown);
      for (const mark of this.scores.querySelectorAll(".prp-swatch"))
        mark.style.setProperty("--colour", colours[Number(mark.textContent) - 1]);
    }

    /** Fill the table: a row a motion with its scores and with the distances of the moment. */
    _fillScores() {
      const { motions } = this.sequence;
      const titles = [...new Set(motions.flatMap((motion) => motion.scores.map((score) => score.title)))];
      const hasDistances = motions.some((motion) => motion.head || motion.wrist);
      const mayChoose = this.options.chooseMotions !== false && motions.length > 1;
      const chosen = this.chosen;
      this._now = [];
      const row = (motion, number) => {
        const box = make("input", {
          type: "checkbox",
          checked: chosen.includes(motion.label),
          "aria-label": `show ${motion.label}`,
        });
        box.addEventListener("change", () => this._choose(motion.label, box));
        const name = make(
          "th",
          { scope: "row" },
          mayChoose ? box : null,
          swatch(number, motion.colour),
          make("span", {}, motion.label),
          motion.kind === "control" ? make("small", {}, " control") : null,
        );
        const cells = titles.map((title) => this._scoreCell(motion.scores.find((score) => score.title === title)));
        const now = hasDistances ? [make("td", { class: "prp-now" }), make("td", { class: "prp-now" })] : [];
        this._now.push(now);
        return make("tr", {}, name, ...now, ...cells);
      };
      const heads = [...(hasDistances ? ["ray now", "wrist now"] : []), ...titles];
      const table = make(
        "table",
        {},
        make("caption", {}, "Scores, and distances to the goal at this moment"),
        make(
          "thead",
          {},
          make(
            "tr",
            {},
            make("th", { scope: "col" }, "motion"),
            ...heads.map((title) => make("th", { scope: "col" }, title)),
          ),
        ),
        make("tbody", {}, ...motions.map(row)),
      );
      this.scores.replaceChildren(
        make("div", { class: "prp-scroll", tabindex: 0, role: "region", "aria-label": "Table of scores" }, table),
      );
    }

    _scoreCell(score) {
      if (!score) return make("td", {}, "–");
      if (score.good === null || score.good === undefined) return make("td", {}, score.text);
      return make("td", { class: score.good ? "prp-pass" : "prp-fail" }, `${score.good ? "✓" : "✗"} ${score.text}`);
    }

    _choose(label, box) {
      const chosen = new Set(this.chosen);
      if (box.checked) chosen.add(label);
      else chosen.delete(label);
      if (chosen.size === 0) {
        box.checked = true; // one motion stays
        this._announce("One motion stays on the stage.");
        return;
      }
      const all = this.sequence.motions.map((motion) => motion.label);
      this.labels = chosen.size === all.length ? null : all.filter((item) => chosen.has(item));
      this.stage.choose(this.chosen);
      this._describe();
      this._paintMotions();
      this._update();
      this._writeHash();
    }

    // -------------------------------------------------------------------------------------------------- the time

    /** Go to a time in seconds; what lies outside the sequence goes to its end. */
    seek(seconds, quietly = false) {
      if (!this.sequence) return;
      this.time = Math.min(Math.max(Number(seconds) || 0, 0), this.sequence.duration);
      this._update();
      if (!quietly && !this.playing) this._remember();
    }

    get frame() {
      return Math.round(this.time * this.sequence.fps);
    }

    /** Move stage, timeline and numbers to the time. */
    _update() {
      const { sequence, time, frame } = this;
      const phase = parts.reading.phase(sequence, time);
      const words = `${time.toFixed(2)} s · frame ${frame + 1} of ${sequence.nFrames} · ${phase}`;
      this.stage.setTime(time);
      this.timeline.setTime(time, `${time.toFixed(2)} seconds of ${sequence.duration.toFixed(2)}, ${phase}`);
      this.clock.textContent = words;
      this.place.dataset.phase = phase === "prime" || time >= sequence.eventTime - 1e-6 ? "mark" : "";
      const { centimetres } = parts.timeline;
      sequence.motions.forEach((motion, number) => {
        const [ray, wrist] = this._now[number];
        if (!ray) return;
        const cell = (element, values, spans, words_) => {
          const good = parts.reading.inSpans(spans, frame);
          element.textContent = values ? `${centimetres(values[frame])}${good ? ` ${words_}` : ""}` : "–";
          element.classList.toggle("prp-pass", good);
        };
        cell(ray, motion.head, motion.onTarget, "on target");
        cell(wrist, motion.wrist, motion.withinReach, "in reach");
      });
    }

    /** Tell a screen reader, and the address, where time stands; soon, but not at every move of a dragged slider. */
    _remember(words = "") {
      clearTimeout(this._soon);
      this._soon = setTimeout(() => {
        if (!this.sequence) return;
        this._announce(this._inWords(words));
        this._writeHash();
      }, 250);
    }

    _inWords(first) {
      const { centimetres } = parts.timeline;
      const { frame, sequence } = this;
      const motions = sequence.motions
        .filter((motion) => this.chosen.includes(motion.label) && motion.head)
        .map((motion) => {
          const sliding = parts.reading.inSpans(motion.sliding, frame) ? ", foot slides" : "";
          return `${motion.label}: ray ${centimetres(motion.head[frame])}, wrist ${centimetres(motion.wrist[frame])}${sliding}`;
        });
      return [first, `${this.time.toFixed(2)} seconds, ${parts.reading.phase(sequence, this.time)}`, ...motions]
        .filter(Boolean)
        .join(". ");
    }

    toggle() {
      if (this.playing) this.pause();
      else this.play();
    }

    play() {
      if (!this.sequence || this.playing || this._recording) return;
      if (this.time >= this.sequence.duration - 1e-6) this.seek(0, true);
      this.playing = true;
      this._setPlayButton();
      let last = null;
      let held = 0;
      const step = (now) => {
        if (!this.playing) return;
        const passed = last === null ? 0 : Math.min((now - last) / 1000, 0.25);
        last = now;
        const { duration, primeTime } = this.sequence;
        const before = this.time;
        if (before < duration) this.seek(before + passed * this.speed, true);
        if (before < primeTime && this.time >= primeTime) this._announce("prime");
        if (this.time >= duration) {
          held += passed;
          if (!this.repeat) {
            this.pause();
            return;
          }
          if (held > 0.7) {
            held = 0;
            this.seek(0, true);
          }
        }
        this._playing = requestAnimationFrame(step);
      };
      this._playing = requestAnimationFrame(step);
    }

    pause() {
      if (!this.playing) return;
      this.playing = false;
      cancelAnimationFrame(this._playing);
      this._setPlayButton();
      this._remember();
    }

    _setPlayButton() {
      const name = this.playing ? "pause" : "play";
      const label = this.playing ? "Pause (Space)" : "Play (Space)";
      this.playButton.replaceChildren(parts.elements.picture(name));
      this.playButton.title = label;
      this.playButton.setAttribute("aria-label", label);
    }

    _goTo(time, words) {
      if (!this.sequence) return;
      this.pause();
      this.seek(time, true);
      this._remember(words);
    }

    _step(frames) {
      if (!this.sequence) return;
      this._goTo((this.frame + frames) / this.sequence.fps, "");
    }

    _jump(direction) {
      if (!this.sequence) return;
      const stops = this.timeline.stops();
      const later = (stop) => (stop.time - this.time) * direction > 1e-3;
      const next = direction > 0 ? stops.find(later) : stops.reverse().find(later);
      // What begins in the same frame is told together.
      const words = next
        ? stops.filter((stop) => Math.abs(stop.time - next.time) < 1e-3).map((stop) => stop.words)
        : [];
      if (next) this._goTo(next.time, words.join("; "));
      else this._announce(direction > 0 ? "No later mark." : "No earlier mark.");
    }

    _changeSpeed(step) {
      const number = Math.min(Math.max(SPEEDS.indexOf(this.speed) + step, 0), SPEEDS.length - 1);
      this.speed = SPEEDS[number];
      this.speedChoice.value = String(this.speed);
      this._announce(`Speed ${this.speed}`);
    }

    _setRepeat(repeat) {
      this.repeat = repeat;
      this.repeatButton.setAttribute("aria-pressed", String(repeat));
    }

    // -------------------------------------------------------------------------------------------------- the view

    _press(group, value) {
      for (const item of group.children) item.setAttribute("aria-pressed", String(item.dataset.value === value));
    }

    _look(view) {
      if (view === "eyes" && this.view === "eyes") this.stage.eyes = (this.stage.eyes || 0) + 1;
      this.view = view;
      this._press(this.viewButtons, view);
      this.stage.look(view);
      this._describe();
    }

    _arrange(layout) {
      this.layout = layout;
      this._press(this.layoutButtons, layout);
      this.stage.setLayout(layout);
    }

    _setLayout(layout) {
      if (!this.sequence || this.sequence.motions.length < 2) return;
      this._choseLayout = true;
      this._arrange(layout);
      this._describe();
      this._announce(LAYOUTS.find(([name]) => name === layout)[2]);
    }

    _setFollow(follow) {
      this.follow = follow;
      this.followButton.setAttribute("aria-pressed", String(follow));
      this.stage.setFollow(follow);
    }

    /** Describe the stage for those who do not see it. */
    _describe() {
      if (!this.stage.canvas || !this.sequence) return;
      const view = VIEWS.find(([name]) => name === this.view)[2]
        .replace(/ \(.*/, "")
        .replace(/;.*/, "");
      this.stage.canvas.setAttribute("aria-label", `${this.sequence.title}: ${this.chosen.join(", ")}. ${view}.`);
    }

    _placeTags(labels) {
      while (this.tags.children.length < labels.length) this.tags.append(make("span", { class: "prp-tag" }));
      const several = this.sequence && this.sequence.motions.length > 1;
      [...this.tags.children].forEach((tag, number) => {
        const label = labels[number];
        tag.hidden = !label || !(several || label.quiet);
        if (!label) return;
        tag.classList.toggle("prp-quiet", Boolean(label.quiet));
        tag.textContent = label.label;
        tag.style.transform = `translate(${label.x}px, ${label.y}px) translate(-50%, -100%)`;
      });
    }

    _theme() {
      const page = document.documentElement.dataset.theme;
      const wanted = this._ownTheme || (page === "dark" || page === "light" ? page : null);
      this.dark = wanted ? wanted === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
      this.root.dataset.prpTheme = this.dark ? "dark" : "light";
      this.stage.setTheme(this.dark);
      if (this.sequence) this._paintMotions();
    }

    _switchTheme() {
      this._ownTheme = this.dark ? "light" : "dark";
      this._theme();
    }

    // ----------------------------------------------------------------------------------------- menu, help, words

    _openMenu() {
      const open = !this.root.classList.contains("prp-menu-open");
      this.root.classList.toggle("prp-menu-open", open);
      this.menuButton.setAttribute("aria-expanded", String(open));
      if (open) this.menu.search.focus();
    }

    _closeMenu() {
      if (!this.root.classList.contains("prp-menu-open")) return;
      this._openMenu();
      this.menuButton.focus();
    }

    _search() {
      if (!this.menu) return;
      if (this.menu.search.offsetParent === null) this._openMenu();
      this.menu.search.focus();
      this.menu.search.select();
    }

    _help() {
      const rows = KEYS.map(([keys, words]) =>
        make(
          "tr",
          {},
          make("th", { scope: "row" }, ...keys.split(" ").map((key) => make("kbd", {}, key))),
          make("td", {}, words),
        ),
      );
      const close = make("button", { type: "button", onclick: () => this.dialog.close() }, "Close");
      this.dialog.replaceChildren(
        make("div", { class: "prp-dialog-top" }, make("h2", {}, "Keys"), close),
        make("table", {}, make("tbody", {}, ...rows)),
        make("h2", {}, "What is seen"),
        make(
          "p",
          {},
          "Rings mark the right arm and leg. The face looks along the head ray; the ray is thick while it is on target. Dashes are the gaze. " +
            "The small sphere around the goal is the limit of reaching, the large one that of priming. Grid lines are 1 m apart, fine ones 25 cm. " +
            "The joints are the data's; skin, fingers and the twist of the limbs are the drawing's. Between two frames, places are interpolated.",
        ),
        make("p", {}, "Drag to turn, wheel or two fingers to come nearer, right button or two fingers to shift."),
      );
      this.dialog.showModal();
      close.focus();
    }

    _say(text) {
      this.status.textContent = text;
      this.status.hidden = !text;
    }

    _announce(text) {
      this.live.textContent = text;
    }

    // --------------------------------------------------------------------------------------------- link and files

    /** Return the part of the address that leads to this moment; what others keep in it stays. */
    _hashOf() {
      const kept = hashParts().filter((part) => !["sequence", "t", "motions"].includes(part.split("=")[0]));
      const own = [`sequence=${encodeURIComponent(this.sequence.id)}`, `t=${this.time.toFixed(2)}`];
      if (this.labels) own.push(`motions=${this.chosen.map(encodeURIComponent).join(",")}`);
      return `#${[...kept, ...own].join("&")}`;
    }

    _writeHash() {
      if (this.options.compact || !this.sequence) return;
      this._hash = this._hashOf();
      try {
        history.replaceState(history.state, "", this._hash);
      } catch {
        // Some browsers forbid it on pages from disk; the button still copies the link.
      }
    }

    async _copy() {
      if (!this.sequence) return;
      const link = location.href.replace(/#.*/, "") + this._hashOf();
      try {
        await navigator.clipboard.writeText(link);
        this._flash("Link copied.");
      } catch {
        const field = make("input", { type: "text", readonly: true, value: link, "aria-label": "Link to this moment" });
        this.dialog.replaceChildren(
          make("h2", {}, "Link to this moment"),
          field,
          make("button", { type: "button", onclick: () => this.dialog.close() }, "Close"),
        );
        this.dialog.showModal();
        field.select();
      }
    }

    /** Say something on the stage for two seconds. */
    _toPrime() {
      if (parts.reading.hasPrime(this.sequence)) this._goTo(this.sequence.primeTime, "prime");
      else this._flash("No prime lies within this motion.");
    }

    _flash(text) {
      this._say(text);
      clearTimeout(this._flashing);
      this._flashing = setTimeout(() => {
        if (this.status.textContent === text) this._say("");
      }, 2000);
    }

    _caption(time) {
      return `${this.sequence.title}  ${time.toFixed(2)} s  ${parts.reading.phase(this.sequence, time)}`;
    }

    /** Return a PNG of the stage as a Blob: on `background`, or transparent (null). */
    async picture(background) {
      if (!this.stage.picture) throw new Error("Without WebGL there is no picture to save.");
      return parts.saving.picture(this.stage, {
        background,
        labels: this.withNames.checked,
        caption: this.withNames.checked ? this._caption(this.time) : "",
        notice: this.sequence.notice,
      });
    }

    async _picture(background) {
      if (!this.sequence) return;
      try {
        parts.saving.download(await this.picture(background), parts.saving.fileName(this.sequence, this.time, "png"));
        this._flash("Picture saved.");
      } catch (error) {
        this._say(error.message);
      }
    }

    async _film() {
      if (!this.sequence || this._recording) return;
      this.pause();
      const before = this.time;
      try {
        if (!this.stage.picture) throw new Error("Without WebGL there is no film to save.");
        this._recording = parts.saving.film(this.stage, {
          duration: this.sequence.duration,
          speed: this.speed,
          caption: (time) => (this.withNames.checked ? this._caption(time) : ""),
          notice: this.sequence.notice,
          onProgress: (share) => {
            this.progress.value = share;
          },
        });
        this.filmRow.hidden = false;
        this.filmButton.disabled = true;
        this._announce("Recording. Keep this tab in front.");
        const film = await this._recording.done;
        if (film) parts.saving.download(film, parts.saving.fileName(this.sequence, null, this._recording.suffix));
        this._flash(film ? "Film saved." : "Film cancelled.");
      } catch (error) {
        this._say(error.message);
      }
      this._recording = null;
      this.filmRow.hidden = true;
      this.filmButton.disabled = false;
      this.seek(before, true);
    }

    destroy() {
      this._token += 1;
      this.playing = false;
      cancelAnimationFrame(this._playing);
      clearTimeout(this._soon);
      clearTimeout(this._flashing);
      if (this._recording) this._recording.cancel();
      for (const remove of this._listeners) remove();
      this._themeWatch.disconnect();
      this.timeline.dispose();
      this.stage.dispose();
      this.root.replaceChildren();
      this.root.classList.remove("prp", "prp-compact", "prp-single", "prp-menu-open");
      for (const name of ["role", "aria-label", "data-prp-theme"]) this.root.removeAttribute(name);
    }
  }

  /**
   * Mount the player in an element.
   *
   * Args:
   *   element: Is filled; give it no own content.
   *   entries: Documents, or what the menu shows of them with `load()`.
   *   options: `sequence` and `time` to begin with, `compact` (small, hears keys only inside, leaves the page's
   *     address alone), `chooseMotions` (false: no boxes to choose motions).
   */
  function mount(element, entries, options = {}) {
    const player = new Player(element, entries, options);
    if (entries.length === 0) player._say("This page has no sequences.");
    else {
      const asked = options.compact ? {} : readHash();
      player.labels = asked.motions || null;
      const id = asked.sequence || options.sequence || entries[0].sequence_id;
      const time = asked.sequence ? asked.time : options.time;
      player.show(id, time === undefined ? null : time);
    }
    return {
      show: (id, time = null) => player.show(id, time),
      seek: (seconds) => player.seek(seconds),
      destroy: () => player.destroy(),
      player,
    };
  }

  prbench.player = { mount };
})();
