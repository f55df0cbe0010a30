// Pictures and films of the stage as files.
(function () {
  "use strict";

  const prbench = (window.prbench = window.prbench || {});
  const parts = (prbench.playerParts = prbench.playerParts || {});
  const { make } = parts.elements;

  const FORMATS = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm", "video/mp4"];
  const FILM_RATE = 30; // frames per second of a film

  /** Hand a file to the user. */
  function download(blob, name) {
    const url = URL.createObjectURL(blob);
    const anchor = make("a", { href: url, download: name });
    document.body.append(anchor);
    anchor.click();
    anchor.remove();
    setTimeout(() => URL.revokeObjectURL(url), 10000);
  }

  /** Return a name for a file: letters, digits and hyphens of the id, and the moment. */
  function fileName(sequence, time, suffix) {
    const id = sequence.id
      .replace(/[^A-Za-z0-9]+/g, "-")
      .replace(/^-|-$/g, "")
      .slice(0, 100);
    return `${id}${time === null ? "" : `-${time.toFixed(2)}s`}.${suffix}`;
  }

  /** Write the names of the motions and the notice of the dataset onto a picture. */
  function annotate(context, width, height, { labels, caption, notice, ink, back }) {
    context.textBaseline = "alphabetic";
    context.lineJoin = "round";
    const write = (text, x, y, size, align, weight = "") => {
      context.font = `${weight} ${size}px system-ui, sans-serif`;
      context.textAlign = align;
      context.lineWidth = 4;
      context.strokeStyle = back;
      context.strokeText(text, x, y);
      context.fillStyle = ink;
      context.fillText(text, x, y);
    };
    for (const { label, x, y } of labels) write(label, x, y, 14, "center", "600");
    if (caption) write(caption, 14, 24, 15, "left", "600");
    if (notice) write(notice, 14, height - 12, 11, "left");
  }

  /** Return a PNG of the stage at a moment, twice as large as on the page. */
  function picture(stage, { background, labels, caption, notice }) {
    const dark = background === null ? stage.dark : false;
    const canvas = stage.picture({
      scale: 2,
      background,
      paint: (context, width, height) =>
        annotate(context, width, height, {
          labels: labels ? stage.labels(width, height) : [],
          caption,
          notice,
          ink: dark ? "#ffffff" : "#14181d",
          back: dark ? "#14181d" : "#ffffff",
        }),
    });
    return new Promise((resolve, reject) => {
      canvas.toBlob(
        (blob) => (blob ? resolve(blob) : reject(new Error("The browser could not write the picture."))),
        "image/png",
      );
    });
  }

  /** Return the first format of films that this browser can record, or null. */
  function filmFormat() {
    if (typeof MediaRecorder === "undefined" || !HTMLCanvasElement.prototype.captureStream) return null;
    return FORMATS.find((format) => MediaRecorder.isTypeSupported(format)) || null;
  }

  /**
   * Record the sequence from its start to its end, in real time.
   *
   * Args:
   *   stage: Draws each moment.
   *   duration, speed: Seconds, and how fast they pass.
   *   caption: Called with a time; returns the line on top of the picture.
   *   onProgress: Called with the recorded share, 0 to 1.
   *
   * Returns `done`, a promise of the film (null if it was cancelled), and `cancel`.
   */
  function film(stage, { duration, speed, caption, notice, onProgress }) {
    const format = filmFormat();
    if (!format) throw new Error("This browser cannot record films. Chromium, Chrome, Edge and Firefox can.");
    const { clientWidth: width, clientHeight: height } = stage.element;
    const canvas = document.createElement("canvas");
    const scale = Math.max(1, Math.min(2, 1920 / width));
    // Encoders want even sides.
    canvas.width = 2 * Math.round((width * scale) / 2);
    canvas.height = 2 * Math.round((height * scale) / 2);
    const context = canvas.getContext("2d", { alpha: false });
    const recorder = new MediaRecorder(canvas.captureStream(FILM_RATE), { mimeType: format, videoBitsPerSecond: 8e6 });
    const pieces = [];
    let cancelled = false;
    recorder.addEventListener("dataavailable", (event) => {
      if (event.data.size) pieces.push(event.data);
    });

    const drawAt = (time) => {
      stage.setTime(time);
      stage.draw();
      context.setTransform(1, 0, 0, 1, 0, 0);
      context.drawImage(stage.canvas, 0, 0, canvas.width, canvas.height);
      context.setTransform(canvas.width / width, 0, 0, canvas.height / height, 0, 0);
      annotate(context, width, height, {
        labels: stage.labels(width, height),
        caption: caption(time),
        notice,
        ink: stage.theme.ink,
        back: stage.theme.back,
      });
    };

    const done = new Promise((resolve, reject) => {
      recorder.addEventListener("error", (event) =>
        reject(event.error || new Error("The film could not be recorded.")),
      );
      recorder.addEventListener("stop", () =>
        resolve(cancelled ? null : new Blob(pieces, { type: format.split(";")[0] })),
      );
      drawAt(0);
      recorder.start(250);
      let begin = null;
      const step = (now) => {
        if (begin === null) begin = now;
        const time = Math.min(((now - begin) / 1000) * speed, duration);
        drawAt(time);
        onProgress(duration > 0 ? time / duration : 1);
        if (cancelled) recorder.stop();
        else if (time < duration) requestAnimationFrame(step);
        else setTimeout(() => recorder.stop(), 500); // the last picture stands for half a second
      };
      requestAnimationFrame(step);
    });
    return {
      done,
      cancel: () => {
        cancelled = true;
      },
      suffix: format.includes("mp4") ? "mp4" : "webm",
    };
  }

  parts.saving = { download, fileName, picture, film, filmFormat };
})();
