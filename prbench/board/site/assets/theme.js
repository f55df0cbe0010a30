"use strict";
// Light or dark before anything is drawn: as the reader chose here, else as the system says.
(() => {
  let chosen = null;
  try {
    chosen = localStorage.getItem("prbench-theme");
  } catch {
    // Pages from disk may not keep anything.
  }
  const dark = chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "dark" : "light";
})();
