// Turns a document of the player (prbench/viewing/player/document.py) into numbers in metres and seconds.
//
// Long columns of a document are base64 of little-endian integers: int16 millimetres, or unit vectors times 10,000.
// Whatever does not fit together is refused with a sentence; nothing is guessed.
(function () {
  "use strict";

  const prbench = (window.prbench = window.prbench || {});
  const parts = (prbench.playerParts = prbench.playerParts || {});

  const VERSION = 1;
  const N_JOINTS = 22;
  const MILLIMETRE = 0.001;
  const UNIT_VECTOR = 0.0001;

  /** Return the bytes of base64 text. */
  function bytesOf(text) {
    const characters = atob(text);
    const bytes = new Uint8Array(characters.length);
    for (let i = 0; i < characters.length; i += 1) bytes[i] = characters.charCodeAt(i);
    return bytes;
  }

  /** Raise an error if a column does not hold the expected count of numbers. */
  function requireCount(found, expected, where) {
    if (found === expected) return;
    throw new Error(
      `${where}: expected ${expected} numbers, found ${found}. Write the page again; its data are cut short.`,
    );
  }

  /** Return int16 numbers times `scale`; `expected` may be null where any count is right. */
  function scaled(text, scale, expected, where) {
    let bytes;
    try {
      bytes = bytesOf(text);
    } catch {
      throw new Error(`${where}: expected base64, found other text. Write the page again; its data are damaged.`);
    }
    const count = Math.floor(bytes.length / 2);
    if (expected !== null) requireCount(count, expected, where);
    const view = new DataView(bytes.buffer);
    const values = new Float32Array(count);
    for (let i = 0; i < count; i += 1) values[i] = view.getInt16(2 * i, true) * scale;
    return values;
  }

  /** Return uint32 numbers: the corners of triangles. */
  function indices(text) {
    const bytes = bytesOf(text);
    const view = new DataView(bytes.buffer);
    const values = new Uint32Array(Math.floor(bytes.length / 4));
    for (let i = 0; i < values.length; i += 1) values[i] = view.getUint32(4 * i, true);
    return values;
  }

  /** Return origins, unit directions and validity of the gaze of one motion. */
  function readGaze(motion, n, where) {
    if (!motion.gaze) return null;
    const millimetres = scaled(motion.gaze, 1, 6 * n, `${where}, gaze`);
    const origin = new Float32Array(3 * n);
    const direction = new Float32Array(3 * n);
    for (let i = 0; i < n; i += 1) {
      for (let axis = 0; axis < 3; axis += 1) {
        origin[3 * i + axis] = millimetres[6 * i + axis] * MILLIMETRE;
        direction[3 * i + axis] = millimetres[6 * i + 3 + axis] * UNIT_VECTOR;
      }
    }
    const valid = motion.gaze_valid ? bytesOf(motion.gaze_valid) : new Uint8Array(n).fill(1);
    requireCount(valid.length, n, `${where}, gaze_valid`);
    return { origin, direction, valid };
  }

  function readMotion(motion, n, sequence) {
    const where = `${sequence}, motion '${motion.label}'`;
    const column = (text, name) => (text ? scaled(text, MILLIMETRE, n, `${where}, ${name}`) : null);
    return {
      label: String(motion.label),
      kind: motion.kind,
      colour: motion.colour,
      joints: scaled(motion.joints, MILLIMETRE, n * N_JOINTS * 3, `${where}, joints`),
      headRay: scaled(motion.head_ray, UNIT_VECTOR, 3 * n, `${where}, head_ray`),
      gaze: readGaze(motion, n, where),
      head: column(motion.head, "head"),
      wrist: column(motion.wrist, "wrist"),
      onTarget: motion.on_target || [],
      withinReach: motion.within_reach || [],
      sliding: motion.sliding || [],
      scores: motion.scores || [],
    };
  }

  /**
   * Read one document.
   *
   * Raises an Error whose message says what is wrong and what to do.
   */
  function read(document_) {
    if (!document_ || typeof document_ !== "object") {
      throw new Error("This sequence has no data. Write the page again.");
    }
    const id = document_.sequence_id;
    if (document_.version !== VERSION) {
      throw new Error(
        `${id}: expected a document of version ${VERSION}, found version ${document_.version}. ` +
          "Write the page again, so that player and data are of one prbench.",
      );
    }
    const n = document_.n_frames;
    if (!(n >= 1) || !document_.motions || document_.motions.length === 0) {
      throw new Error(`${id}: expected at least one frame and one motion. Write the page again.`);
    }
    return {
      id,
      dataset: document_.dataset,
      title: document_.title,
      action: document_.action,
      fps: document_.fps,
      nFrames: n,
      duration: (n - 1) / document_.fps,
      primeTime: document_.prime_time,
      eventTime: document_.event_time,
      notice: document_.notice || "",
      goal: document_.goal || null,
      limits: document_.limits || {},
      objects: (document_.objects || []).map((object) => ({
        name: object.name,
        box: object.box,
        path: object.path ? scaled(object.path, MILLIMETRE, 3 * n, `${id}, object '${object.name}'`) : null,
      })),
      mesh: document_.mesh
        ? {
            vertices: scaled(document_.mesh.vertices, MILLIMETRE, null, `${id}, mesh`),
            triangles: indices(document_.mesh.triangles),
          }
        : null,
      motions: document_.motions.map((motion) => readMotion(motion, n, id)),
    };
  }

  /** Return true if a frame lies in one of the spans `[[first, last], ...]`. */
  function inSpans(spans, frame) {
    return spans.some(([first, last]) => frame >= first && frame <= last);
  }

  /** Return true if the prime lies within the motion; around the event of a review it may lie before, or be none. */
  function hasPrime(sequence) {
    return sequence.primeTime >= 0 && sequence.primeTime <= sequence.duration + 0.5 / sequence.fps;
  }

  /** Name what happens at a time: before or after the prime, the prime itself, the event. */
  function phase(sequence, time) {
    const half = 0.5 / sequence.fps;
    const event = sequence.action || "event";
    if (time > sequence.eventTime + half) return `after ${event}`;
    if (time >= sequence.eventTime - half) return event;
    if (!hasPrime(sequence)) return `before ${event}`;
    if (Math.abs(time - sequence.primeTime) <= half) return "prime";
    return time < sequence.primeTime ? "before prime" : "after prime";
  }

  parts.reading = { read, inSpans, hasPrime, phase };
})();
