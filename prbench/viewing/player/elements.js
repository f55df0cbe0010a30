// Elements of a page, made with text that is never read as HTML.
(function () {
  "use strict";

  const prbench = (window.prbench = window.prbench || {});
  const parts = (prbench.playerParts = prbench.playerParts || {});
  const SVG = "http://www.w3.org/2000/svg";

  function fill(element, attributes, children) {
    for (const [name, value] of Object.entries(attributes || {})) {
      if (value === null || value === undefined || value === false) continue;
      if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
      else element.setAttribute(name, value === true ? "" : value);
    }
    for (const child of children.flat()) if (child !== null && child !== undefined) element.append(child);
    return element;
  }

  /** Return an HTML element; attributes that begin with "on" are listeners, children are elements or text. */
  const make = (tag, attributes, ...children) => fill(document.createElement(tag), attributes, children);

  /** Return an SVG element. */
  const svg = (tag, attributes, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);

  const PATHS = {
    play: "M7 4.5v15l13-7.5z",
    pause: "M6 4.5h4v15H6zM14 4.5h4v15h-4z",
    back: "M18 5v14l-9-7zM6 5h2.5v14H6z",
    ahead: "M6 5v14l9-7zM15.5 5H18v14h-2.5z",
    previous: "M12 5v14l-8-7zM20 5v14l-8-7z",
    next: "M12 5v14l8-7zM4 5v14l8-7z",
    loop: "M7 7h10v3l4-4-4-4v3H5v6h2zm10 10H7v-3l-4 4 4 4v-3h12v-6h-2z",
    theme: "M12 3a9 9 0 1 0 0 18zM12 3a9 9 0 0 1 0 18z",
  };

  /** Return a button with a picture, or with words where `icon` is none of the pictures. */
  function button(icon, label, act, attributes = {}) {
    const inside = PATHS[icon] ? picture(icon) : icon;
    return make(
      "button",
      { type: "button", title: label, "aria-label": PATHS[icon] ? label : null, onclick: act, ...attributes },
      inside,
    );
  }

  /** Return one of the small pictures of buttons. */
  const picture = (icon) =>
    svg(
      "svg",
      { viewBox: "0 0 24 24", width: 20, height: 20, "aria-hidden": "true", focusable: "false" },
      svg("path", { d: PATHS[icon], fill: "currentColor" }),
    );

  /** Return a small sample of how a motion is drawn: its number on its colour, so that colour is never alone. */
  function swatch(number, colour) {
    const mark = make("span", { class: "prp-swatch", "aria-hidden": "true" }, String(number + 1));
    mark.style.setProperty("--colour", colour);
    return mark;
  }

  parts.elements = { make, svg, button, picture, swatch };
})();
