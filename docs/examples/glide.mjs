// Glide: a complete method for prbench in JavaScript (Node 18 or later and `npm install` beside this file).
//
//     prbench run --method "cmd:node glide.mjs" --condition goal-loc --data DIR
//
// It speaks wire protocol 1 (docs/wire-protocol.md): conditions come in on stdin, motions go out on stdout. The method is
// that of glide.py, in the same order of operations, so that both give the same bytes. A motion is a Float64Array of
// n_frames * 66 numbers; a point of it is addressed by the place of its x.

import { readSync, writeSync } from "node:fs";
import { Field, Float32, List, Table, Utf8, Vector, makeData, tableFromIPC, tableToIPC, vectorFromArray } from "apache-arrow";

const PELVIS = 0, NECK = 12, HEAD = 15;
const ARMS = [[16, 18, 20], [17, 19, 21]]; // shoulder, elbow, wrist; left, right
const LEFT_HIP = 1, RIGHT_HIP = 2, LEFT_SHOULDER = 16, RIGHT_SHOULDER = 17;
const UPPER_BODY = [3, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21];
const LEANS = [[1, 0], [12 / 13, 5 / 13], [4 / 5, 3 / 5], [3 / 5, 4 / 5], [5 / 13, 12 / 13]]; // cosine, sine; 0 to 67 degrees
const PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19];

// ---------------------------------------------------------------- the method

function motion(row, nFrames, fps, settings) {
  const chance = uniforms(row.noise_seed, 3);
  const time = Float64Array.from({ length: nFrames }, (_, frame) => frame / fps);
  return row.goal_joints
    ? intoPose(row.initial_joints, row.goal_joints, time, fps, chance)
    : toLocation(row.initial_joints, row.goal_location, time, fps, chance, settings);
}

// Numbers in [0, 1) that depend on the noise seed, a BigInt, alone (SplitMix64).
function uniforms(noiseSeed, count) {
  const numbers = [];
  for (let step = 1n; step <= count; step++) {
    let z = BigInt.asUintN(64, noiseSeed + step * 0x9e3779b97f4a7c15n);
    z = BigInt.asUintN(64, (z ^ (z >> 30n)) * 0xbf58476d1ce4e5b9n);
    z = BigInt.asUintN(64, (z ^ (z >> 27n)) * 0x94d049bb133111ebn);
    numbers.push(Number((z ^ (z >> 31n)) >> 11n) / 2 ** 53);
  }
  return numbers;
}

// Face the goal at about 2 s, then glide until it is within arm's length and reach with the nearer hand.
function toLocation(initial, goal, time, fps, chance, settings) {
  const arrive = 1.8 + 0.2 * chance[0];
  const stop = settings.stopBefore + 0.1 * chance[1];
  const end = time[time.length - 1];
  const begin = Math.min(arrive, Math.max(end - 0.5, 0));
  const turned = time.map((t) => smooth(t / arrive));
  const reached = time.map((t) => smooth((t - begin) / Math.max(end - begin, 1 / fps)));

  const pelvis = at(initial, PELVIS);
  const toGoal = minus(goal, pelvis);
  const distance = Math.sqrt(toGoal[0] * toGoal[0] + toGoal[2] * toGoal[2]);
  const [cosine, sine] = distance > 1e-6 ? [toGoal[2] / distance, toGoal[0] / distance] : [1, 0];
  const way = Math.max(distance - stop, 0);

  let body = turnedAboutY(relativeToPelvis(initial), 1, cosine, sine, turned);
  time.forEach((_, frame) => {
    const moved = [pelvis[0] + sine * way * reached[frame], pelvis[1], pelvis[2] + cosine * way * reached[frame]];
    shift(body, frame, moved);
  });
  const last = (time.length - 1) * 66;
  const [left, right] = ARMS.map((arm) => norm(minus(at(body, arm[2], last), goal)));
  const arm = left <= right ? ARMS[0] : ARMS[1];
  body = leaningTo(body, arm, goal, cosine, sine, reached);
  time.forEach((_, frame) => lookAt(body, frame * 66, goal, turned[frame]));
  reach(body, arm, goal, reached, 0.1 * chance[2]);
  return body;
}

// Carry the pelvis over and turn each bone from its first direction into its last; lengths go along.
function intoPose(initial, final, time, fps, chance) {
  const phases = time.map((t) => t / Math.max(time[time.length - 1], 1 / fps));
  const progress = phases.map((phase) => smooth(phase + (0.6 * chance[0] - 0.3) * phase * (1 - phase))); // some hurry
  const [cosine, sine] = heading(final);
  const ahead = turnedAboutY(relativeToPelvis(final), 1, cosine, -sine, [1]);
  const start = relativeToPelvis(initial);
  const blended = new Float64Array(time.length * 66);
  for (let joint = 1; joint < 22; joint++) {
    const parent = PARENTS[joint];
    const first = minus(at(start, joint), at(start, parent));
    const last = minus(at(ahead, joint), at(ahead, parent));
    const firstLength = norm(first), lastLength = norm(last);
    progress.forEach((p, frame) => {
      const size = (1 - p) * firstLength + p * lastLength;
      const direction = first.map(
        (value, axis) => ((1 - p) * value) / Math.max(firstLength, 1e-9) + (p * last[axis]) / Math.max(lastLength, 1e-9),
      );
      const scale = size / Math.max(norm(direction), 1e-9);
      const from = at(blended, parent, frame * 66);
      put(blended, joint, frame * 66, from.map((value, axis) => value + direction[axis] * scale));
    });
  }
  const body = turnedAboutY(blended, time.length, cosine, sine, progress);
  const from = at(initial, PELVIS), to = at(final, PELVIS);
  progress.forEach((p, frame) => shift(body, frame, from.map((value, axis) => (1 - p) * value + p * to[axis])));
  return body;
}

// Lean from the hips towards the goal, no further than its arm needs.
function leaningTo(body, [shoulder, elbow, wrist], goal, cosine, sine, progress) {
  const reached = norm(minus(at(body, elbow), at(body, shoulder))) + norm(minus(at(body, wrist), at(body, elbow)));
  let leaning;
  for (const [leanCosine, leanSine] of LEANS) {
    leaning = body.slice();
    progress.forEach((p, index) => {
      const frame = index * 66, [c, s] = partOfTurn(leanCosine, leanSine, p);
      for (const joint of UPPER_BODY) {
        const point = at(body, joint, frame), offset = minus(point, at(body, PELVIS, frame));
        const ahead = offset[0] * sine + offset[2] * cosine, up = offset[1];
        const further = ahead * c + up * s - ahead;
        put(leaning, joint, frame, [point[0] + further * sine, point[1] + (up * c - ahead * s - up), point[2] + further * cosine]);
      }
    });
    if (norm(minus(at(leaning, shoulder, (progress.length - 1) * 66), goal)) <= 0.98 * reached) break;
  }
  return leaning;
}

// Bend the neck of one frame until a line of sight at right angles to it meets the goal.
function lookAt(body, frame, goal, progress) {
  const neck = at(body, NECK, frame), head = at(body, HEAD, frame);
  const bone = minus(head, neck);
  const size = Math.max(norm(bone), 1e-9);
  const sight = unit(minus(goal, head));
  const share = dot(bone, sight);
  const upright = unit(bone.map((value, axis) => value - share * sight[axis]));
  const bent = bone.map((value, axis) => (1 - progress) * (value / size) + progress * upright[axis]);
  const scale = size / Math.max(norm(bent), 1e-9);
  put(body, HEAD, frame, neck.map((value, axis) => value + bent[axis] * scale));
}

// Move the wrist of one arm to the goal, or as near as the arm gets; both bones keep their lengths.
function reach(body, [shoulder, elbow, wrist], goal, progress, lift) {
  const upper = norm(minus(at(body, elbow), at(body, shoulder)));
  const lower = norm(minus(at(body, wrist), at(body, elbow)));
  const missing = minus(goal, at(body, wrist, (progress.length - 1) * 66));
  progress.forEach((p, index) => {
    const frame = index * 66;
    const root = at(body, shoulder, frame);
    const hand = at(body, wrist, frame).map((value, axis) => value + p * missing[axis]);
    hand[1] = hand[1] + lift * 4 * p * (1 - p); // over an edge rather than through it
    const toHand = minus(hand, root);
    const far = Math.max(norm(toHand), 1e-6);
    const direction = toHand.map((value) => value / far);
    const distance = Math.min(Math.max(far, Math.abs(upper - lower) + 1e-4), upper + lower - 1e-4);
    let side = minus(at(body, elbow, frame), root);
    side[1] = side[1] - 0.05 * p; // an arm that was straight bends downwards
    const share = dot(side, direction);
    side = unit(side.map((value, axis) => value - share * direction[axis]));
    const along = (distance * distance + upper * upper - lower * lower) / (2 * distance);
    const height = Math.sqrt(Math.max(upper * upper - along * along, 0));
    put(body, elbow, frame, root.map((value, axis) => value + direction[axis] * along + side[axis] * height));
    put(body, wrist, frame, root.map((value, axis) => value + direction[axis] * distance));
  });
}

// 0 to 1 with speed and acceleration zero at both ends.
function smooth(phase) {
  const x = Math.min(Math.max(phase, 0), 1);
  return x * x * x * (10 - 15 * x + 6 * x * x);
}

// Cosine and sine of the yaw of a pose: (1, 0) faces +Z, (0, 1) faces +X.
function heading(pose) {
  const across = at(pose, RIGHT_HIP).map(
    (value, axis) =>
      value - pose[LEFT_HIP * 3 + axis] + pose[RIGHT_SHOULDER * 3 + axis] - pose[LEFT_SHOULDER * 3 + axis],
  );
  const size = Math.sqrt(across[0] * across[0] + across[2] * across[2]);
  return size > 1e-9 ? [-across[0] / size, across[2] / size] : [1, 0];
}

// One pose, or as many as progress has entries, turned about the vertical by a growing part of a yaw.
function turnedAboutY(points, frames, cosine, sine, progress) {
  const turned = new Float64Array(progress.length * 66);
  progress.forEach((p, frame) => {
    const [c, s] = partOfTurn(cosine, sine, p);
    for (let joint = 0; joint < 22; joint++) {
      const [x, y, z] = at(points, joint, frames === 1 ? 0 : frame * 66);
      put(turned, joint, frame * 66, [x * c + z * s, y, z * c - x * s]);
    }
  });
  return turned;
}

// Cosine and sine of the part of an angle that is reached at a progress.
function partOfTurn(cosine, sine, progress) {
  const halfCosine = Math.sqrt(Math.max(1 + cosine, 0) / 2);
  const halfSine = Math.sqrt(Math.max(1 - cosine, 0) / 2) * (sine >= 0 ? 1 : -1);
  const real = 1 - progress + progress * halfCosine, imaginary = progress * halfSine;
  const size = Math.sqrt(real * real + imaginary * imaginary);
  const c = real / size, s = imaginary / size;
  return [c * c - s * s, 2 * c * s];
}

function relativeToPelvis(pose) {
  return pose.map((value, place) => value - pose[place % 3]);
}

function shift(body, frame, offset) {
  for (let place = frame * 66; place < frame * 66 + 66; place++) body[place] = body[place] + offset[place % 3];
}

function at(points, joint, frame = 0) {
  const place = frame + joint * 3;
  return [points[place], points[place + 1], points[place + 2]];
}

function put(points, joint, frame, point) {
  points.set(point, frame + joint * 3);
}

function minus(a, b) {
  return [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
}

function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function norm(a) {
  return Math.sqrt(dot(a, a));
}

function unit(a) {
  const size = Math.max(norm(a), 1e-9);
  return a.map((value) => value / size);
}

// ---------------------------------------------------------------- the protocol

function main() {
  console.log = console.error; // stdout belongs to the protocol
  const hello = readMessage();
  let settings;
  try {
    settings = readSettings(hello?.header);
  } catch (error) {
    writeMessage({ message: "error", text: error.message });
    return;
  }
  writeMessage({ message: "hello", wire: 1, name: "glide", version: "1.0", conditions: ["goal-loc", "goal-pose"] });
  for (let request = readMessage(); request !== null; request = readMessage()) {
    if (request.header.message !== "generate") continue;
    const batch = request.header.batch;
    let payload;
    try {
      payload = generate(request.header, request.payload, settings);
    } catch (error) {
      console.error(error); // the log
      writeMessage({ message: "error", batch, text: String(error), out_of_memory: error instanceof RangeError });
      continue;
    }
    writeMessage({ message: "motions", batch }, payload);
  }
}

function readSettings(hello) {
  if (hello?.wire !== 1) throw new Error("glide speaks wire protocol 1 only");
  if (hello.weights != null) throw new Error("glide has no weights");
  const settings = { stopBefore: 0.4 }; // metres between pelvis and goal, on the ground
  for (const [key, value] of Object.entries(hello.options ?? {})) {
    if (key !== "stop-before") throw new Error(`unknown option '${key}'; glide knows stop-before (metres)`);
    settings.stopBefore = Number(value);
    if (Number.isNaN(settings.stopBefore)) throw new Error(`stop-before: expected metres, found '${value}'`);
  }
  return settings;
}

function generate(header, payload, settings) {
  const table = tableFromIPC(payload);
  const [ids, seeds, lengths] = ["opaque_id", "noise_seed", "n_frames"].map((name) => table.getChild(name));
  const given = ["initial_joints", "goal_joints", "goal_location"].filter((name) => table.getChild(name));
  const motions = [];
  for (let i = 0; i < table.numRows; i++) {
    const row = { noise_seed: seeds.get(i) };
    for (const name of given) row[name] = Float64Array.from(table.getChild(name).get(i).toArray());
    motions.push(motion(row, lengths.get(i), header.fps, settings));
  }
  return motionsPayload(Array.from(ids), motions);
}

// An Arrow IPC stream with one record batch: opaque_id utf8, joints list<float32>.
function motionsPayload(ids, motions) {
  const valueOffsets = new Int32Array(motions.length + 1);
  motions.forEach((values, i) => (valueOffsets[i + 1] = valueOffsets[i] + values.length));
  const flat = new Float32Array(valueOffsets[motions.length]);
  motions.forEach((values, i) => flat.set(values, valueOffsets[i]));
  const type = new List(new Field("item", new Float32(), true));
  const child = makeData({ type: new Float32(), length: flat.length, nullCount: 0, data: flat });
  const joints = new Vector([makeData({ type, length: motions.length, nullCount: 0, valueOffsets, child })]);
  return tableToIPC(new Table({ opaque_id: vectorFromArray(ids, new Utf8()), joints }), "stream");
}

let ahead = Buffer.alloc(0); // read, but not yet used

// The next header and payload, or null at the end of stdin.
function readMessage() {
  let end;
  while ((end = ahead.indexOf(0x0a)) < 0) if (!readMore(65536)) return null;
  const header = JSON.parse(ahead.toString("utf8", 0, end));
  ahead = ahead.subarray(end + 1);
  const size = header.bytes ?? 0;
  while (ahead.length < size) if (!readMore(size - ahead.length)) return null;
  const payload = new Uint8Array(ahead.subarray(0, size)); // a copy, which starts where Arrow wants it
  ahead = ahead.subarray(size);
  return { header, payload };
}

// Waits for at most `size` bytes of stdin; false at its end.
function readMore(size) {
  const chunk = Buffer.alloc(size);
  const count = insist(() => readSync(0, chunk, 0, size, null));
  ahead = Buffer.concat([ahead, chunk.subarray(0, count)]);
  return count > 0;
}

function writeMessage(header, payload = new Uint8Array(0)) {
  const line = JSON.stringify(payload.length ? { ...header, bytes: payload.length } : header) + "\n";
  const message = Buffer.concat([Buffer.from(line, "utf8"), payload]);
  for (let done = 0; done < message.length; ) done += insist(() => writeSync(1, message, done));
}

// The result of a call on a pipe that may not be ready yet; 0 at the end of a pipe on Windows, which says so by an error.
function insist(call) {
  for (;;) {
    try {
      return call();
    } catch (error) {
      if (error.code === "EOF") return 0;
      if (error.code !== "EAGAIN") throw error;
      Atomics.wait(new Int32Array(new SharedArrayBuffer(4)), 0, 0, 5); // 5 ms
    }
  }
}

main();
