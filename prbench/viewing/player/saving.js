// Pictures and films of the stage as files.
(function () {
  "use strict";

  const prbench = (window.prbench = window.prbench || {});
  const parts = (prbench.playerParts = prbench.playerParts || {});
  const { make } = parts.elements;

  const FORMATS = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm", "video/mp4"];

  const CAPTION = 48; // pixels that the caption takes at the top: names stay below it

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
      .slice(-100);
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
    for (const { label, x, y, quiet } of labels) write(label, x, y, quiet ? 11 : 14, "center", quiet ? "" : "600");
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
          labels: labels ? stage.labels(width, height, caption ? CAPTION : 24) : [],
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
   * Return a recorded WebM with its duration written into it, so that players can jump in it.
   *
   * Recorders leave the duration out, because they write the head before they know it. What has one already, or is laid
   * out otherwise than recorders do, comes back as it is.
   */
  function withDuration(bytes, milliseconds) {
    const INFO = [0x15, 0x49, 0xa9, 0x66];
    const start = bytes.subarray(0, 400).findIndex((_, i) => INFO.every((byte, k) => bytes[i + k] === byte));
    if (start < 0) return bytes;
    // The size follows the id: bytes whose count is told by the leading zeros of the first.
    const count = Math.clz32(bytes[start + 4]) - 23;
    let size = bytes[start + 4] & (0xff >> count);
    for (let i = 1; i < count; i += 1) size = size * 256 + bytes[start + 4 + i];
    const begin = start + 4 + count;
    const content = bytes.subarray(begin, begin + size);
    if (content.some((byte, i) => byte === 0x44 && content[i + 1] === 0x89 && content[i + 2] === 0x88)) return bytes;
    const duration = new DataView(new ArrayBuffer(11));
    duration.setUint32(0, 0x44898800);
    duration.setFloat64(3, milliseconds);
    const newSize = new DataView(new ArrayBuffer(8));
    newSize.setUint32(0, 0x01000000);
    newSize.setUint32(4, size + 11);
    const pieces = [
      bytes.subarray(0, start + 4),
      new Uint8Array(newSize.buffer),
      content,
      new Uint8Array(duration.buffer),
    ];
    return new Blob([...pieces, bytes.subarray(begin + size)]);
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
    const stream = canvas.captureStream(0); // a frame is taken when it is asked for, so none is lost or taken twice
    const camera = stream.requestFrame ? stream : stream.getVideoTracks()[0];
    const recorder = new MediaRecorder(stream, { mimeType: format, videoBitsPerSecond: 8e6 });
    const pieces = [];
    let cancelled = false;
    let began = 0;
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
        labels: stage.labels(width, height, CAPTION),
        caption: caption(time),
        notice,
        ink: stage.theme.ink,
        back: stage.theme.back,
      });
      camera.requestFrame();
    };

    const done = new Promise((resolve, reject) => {
      recorder.addEventListener("error", (event) =>
        reject(event.error || new Error("The film could not be recorded.")),
      );
      recorder.addEventListener("stop", () => {
        stage.sharpen(null);
        if (cancelled) return resolve(null);
        const whole = new Blob(pieces, { type: format.split(";")[0] });
        if (!format.includes("webm")) return resolve(whole);
        const lasted = performance.now() - began;
        return whole
          .arrayBuffer()
          .then((buffer) => resolve(new Blob([withDuration(new Uint8Array(buffer), lasted)], { type: whole.type })))
          .catch(reject);
      });
      stage.sharpen(canvas.width / width);
      recorder.start(250);
      began = performance.now();
      drawAt(0);
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

  parts.saving = { download, fileName, picture, film };
})();
