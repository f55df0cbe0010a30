// Mouse, pen and fingers on the stage: one turns the camera, the wheel or two fingers come nearer, two fingers or the
// right button shift.
(function () {
  "use strict";

  const prbench = (window.prbench = window.prbench || {});
  const parts = (prbench.playerParts = prbench.playerParts || {});

  /**
   * Listen on an element.
   *
   * `act` has `start()`, called when a hand takes hold; `turn(x, y)` and `shift(x, y)`, shares of the element's height
   * by which it moved; `nearer(factor)`, by which the distance changes. Returns a function that ends it.
   */
  function listen(element, act) {
    const held = new Map(); // pointers that are down: where each is
    const middle = () => {
      const all = [...held.values()];
      return [0, 1].map((axis) => all.reduce((sum, place) => sum + place[axis], 0) / all.length);
    };
    const spread = () => {
      const [one, other] = [...held.values()];
      return other ? Math.hypot(one[0] - other[0], one[1] - other[1]) : 0;
    };
    let shifts = false;
    const listeners = {
      pointerdown(event) {
        held.set(event.pointerId, [event.clientX, event.clientY]);
        element.setPointerCapture(event.pointerId);
        shifts = event.button === 2 || event.shiftKey || event.ctrlKey;
        act.start();
      },
      pointermove(event) {
        if (!held.has(event.pointerId)) return;
        const [x, y] = middle();
        const before = spread();
        held.set(event.pointerId, [event.clientX, event.clientY]);
        const [newX, newY] = middle();
        const across = (newX - x) / element.clientHeight;
        const down = (newY - y) / element.clientHeight;
        if (held.size > 1) {
          act.shift(across, down);
          if (before > 0 && spread() > 0) act.nearer(before / spread());
        } else if (shifts) act.shift(across, down);
        else act.turn(across, down);
      },
      pointerup: (event) => held.delete(event.pointerId),
      pointercancel: (event) => held.delete(event.pointerId),
      wheel(event) {
        event.preventDefault();
        act.start();
        const lines = event.deltaMode === 1 ? 16 : 1; // a wheel counts pixels or lines
        act.nearer(Math.exp(Math.min(Math.max(event.deltaY * lines, -240), 240) * 0.0012));
      },
      contextmenu: (event) => event.preventDefault(),
    };
    for (const [type, listener] of Object.entries(listeners))
      element.addEventListener(type, listener, { passive: false });
    return () => {
      for (const [type, listener] of Object.entries(listeners)) element.removeEventListener(type, listener);
    };
  }

  parts.hands = { listen };
})();
