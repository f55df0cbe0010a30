// The player: mounts stage, timeline, menu and controls in an element of a page.
(function () {
  "use strict";

  const prbench = (window.prbench = window.prbench || {});
  const parts = prbench.playerParts;

  function mount(element, entries, options = {}) {
    element.classList.add("prp");
    const place = document.createElement("div");
    place.className = "prp-stage";
    element.append(place);
    const stage = new parts.stage.Stage(place, {});
    const slider = document.createElement("input");
    slider.type = "range";
    slider.step = "0.01";
    element.append(slider);
    slider.addEventListener("input", () => stage.setTime(Number(slider.value)));
    async function show(id, time) {
      const entry = entries.find((item) => item.sequence_id === id) || entries[0];
      const sequence = parts.reading.read(entry.load ? await entry.load() : entry);
      stage.show(sequence, sequence.motions.map((motion) => motion.label));
      slider.max = sequence.duration;
      seek(time || 0);
    }
    function seek(seconds) {
      slider.value = seconds;
      stage.setTime(seconds);
    }
    show(options.sequence, options.time);
    return { show, seek, destroy: () => stage.dispose(), stage };
  }

  prbench.player = { mount };
})();
