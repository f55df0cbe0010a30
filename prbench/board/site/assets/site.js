"use strict";
// What all pages share: the switch of light and dark, scripts read on demand, small helpers, and the player's opening.
(() => {
  const prbench = (window.prbench = window.prbench || {});
  const site = (prbench.site = {});
  const root = location.pathname.includes("/runs/") ? "../" : "";

  // --- light and dark ---
  const button = document.getElementById("theme");
  const name = () => (document.documentElement.dataset.theme === "dark" ? "Light" : "Dark");
  button.hidden = false;
  button.textContent = name();
  button.addEventListener("click", () => {
    const next = name().toLowerCase();
    document.documentElement.dataset.theme = next;
    button.textContent = name();
    try {
      localStorage.setItem("prbench-theme", next);
    } catch {
      // Pages from disk may not keep anything.
    }
  });

  // --- scripts read on demand; each hands its value over by its key ---
  const values = new Map();
  const waiting = new Map();
  prbench.arrived = (key, value) => {
    values.set(key, value);
    if (waiting.has(key)) waiting.get(key)(value);
  };
  const once = new Map();
  site.script = (path) => {
    if (!once.has(path)) {
      once.set(path, new Promise((resolve, reject) => {
        const element = document.createElement("script");
        element.src = root + path;
        element.onload = resolve;
        element.onerror = () => {
          once.delete(path);
          reject(new Error(`${path} is not there`));
        };
        document.head.append(element);
      }));
    }
    return once.get(path);
  };
  site.load = async (path, key) => {
    if (!values.has(key)) await site.script(path);
    return values.get(key);
  };
  site.arrivedAt = (key) => values.get(key);

  // --- elements: text is only ever set as text ---
  const SVG = "http://www.w3.org/2000/svg";
  const fill = (element, attributes, children) => {
    for (const [key, value] of Object.entries(attributes || {})) {
      if (key === "text") element.textContent = value;
      else if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
      else if (value !== null && value !== undefined && value !== false) element.setAttribute(key, value);
    }
    element.append(...(children || []));
    return element;
  };
  site.make = (tag, attributes, ...children) => fill(document.createElement(tag), attributes, children);
  site.draw = (tag, attributes, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);
  site.data = () => JSON.parse(document.getElementById("data").textContent);

  // A badge says with a sign and a word, not with colour alone, whether scores were held against the motions.
  site.badges = ({ control, open, why }) => [
    ...(control ? [site.make("span", { class: "badge control", text: "control" })] : []),
    site.make("span", { class: `badge ${open ? "open" : "sure"}`, title: why, text: open ? "unverified" : "verified" }),
  ];

  // --- the part of the address behind #, as names and values ---
  site.address = () => new URLSearchParams(location.hash.slice(1));
  site.setAddress = (values) => {
    const kept = new URLSearchParams();
    for (const [key, value] of Object.entries(values)) if (value) kept.set(key, value);
    history.replaceState(null, "", `#${kept}`);
  };

  // --- round numbers for an axis ---
  site.ticks = (low, high, most) => {
    const raw = (high - low) / most || 1;
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((each) => each >= raw);
    const found = [];
    for (let value = Math.ceil(low / step) * step; value <= high + step * 1e-6; value += step) found.push(value);
    return found.map((value) => Number(value.toPrecision(8)));
  };

  // --- the player: its scripts and every motion are read when somebody looks ---
  const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#999933", "#882255"];
  const documentOf = async (sequence, runs) => {
    const base = await site.load(`motions/${sequence.file}.js`, sequence.file);
    const motions = await Promise.all(runs.map(({ key }) => {
      const name = `${sequence.file}-${key}`;
      return site.load(`motions/${name}.js`, name);
    }));
    const own = motions.map((motion, i) => ({ ...motion, label: runs[i].label, colour: COLOURS[i % COLOURS.length] }));
    return { ...base, motions: [...base.motions, ...own] };
  };
  let handle = null;
  site.openPlayer = async (sequences, runs, chosen, time) => {
    const section = document.getElementById("player-section");
    const place = document.getElementById("player");
    section.hidden = false;
    const there = (sequence) => runs.filter(({ key }) => sequence.runs[key]);
    if (!document.getElementById("player-style")) {
      document.head.append(site.make("link", { id: "player-style", rel: "stylesheet", href: `${root}assets/player.css` }));
    }
    await site.script("assets/player.js");
    if (!prbench.player) {
      place.textContent = "This site was made without the player.";
      return;
    }
    if (handle === null) {
      const entries = sequences.map((sequence) => ({
        sequence_id: sequence.sequence_id,
        dataset: sequence.file.split("/")[0],
        title: sequence.title,
        motions: there(sequence).map(({ key, label }) => ({ label, scores: sequence.runs[key] })),
        load: () => documentOf(sequence, there(sequence)),
      }));
      handle = prbench.player.mount(place, entries, { sequence: chosen, time, chooseMotions: true });
    } else {
      handle.show(chosen, time);
    }
    section.scrollIntoView({ block: "start" });
  };
  site.closePlayer = () => {
    if (handle) handle.destroy();
    handle = null;
    document.getElementById("player-section").hidden = true;
  };
})();
