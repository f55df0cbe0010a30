// A smooth mannequin that follows the 22 joints (HumanML3D order: prbench/geometry/skeleton.py).
//
// Its skin is made here, once a page: round cones along the bones of a resting body are melted together into one
// surface. A motion then turns, shifts and stretches each bone so that both of its ends stand exactly at the joints of
// the data, so a method that changes the lengths of bones is seen to do so. Joints say nothing of the twist of a limb,
// nor of fingers: the limbs turn the shortest way from their parent. The face looks along the head ray.
(function () {
  "use strict";

  const prbench = (window.prbench = window.prbench || {});
  const parts = (prbench.playerParts = prbench.playerParts || {});

  // Joints of a resting body of 1.7 m with its arms half lowered; metres, Y up, its left side on +X, soles near Y = 0.
  const REST = [
    [0, 0.94, 0],
    [0.066, 0.855, -0.005],
    [-0.066, 0.855, -0.005],
    [0, 1.05, -0.022],
    [0.1, 0.48, -0.005],
    [-0.1, 0.48, -0.005],
    [0, 1.185, -0.022],
    [0.09, 0.078, -0.045],
    [-0.09, 0.078, -0.045],
    [0, 1.24, -0.004],
    [0.115, 0.024, 0.075],
    [-0.115, 0.024, 0.075],
    [0, 1.452, -0.035],
    [0.08, 1.36, -0.025],
    [-0.08, 1.36, -0.025],
    [0, 1.525, 0.012],
    [0.172, 1.39, -0.035],
    [-0.172, 1.39, -0.035],
    [0.372, 1.225, -0.045],
    [-0.372, 1.225, -0.045],
    [0.562, 1.07, -0.02],
    [-0.562, 1.07, -0.02],
  ];

  // The stiff pieces of the body: name, joint where it begins, joint where it ends, the piece that carries it.
  // `null` as the end: the piece ends in the air (head, hands) and takes the direction of its parent or of the head ray.
  const PIECES = [
    ["pelvis", 0, 3, -1],
    ["waist", 3, 6, 0],
    ["ribs", 6, 9, 1],
    ["chest", 9, 12, 2],
    ["neck", 12, 15, 3],
    ["head", 15, null, 4],
    ["leftCollar", 13, 16, 3],
    ["rightCollar", 14, 17, 3],
    ["leftUpperArm", 16, 18, 6],
    ["rightUpperArm", 17, 19, 7],
    ["leftForearm", 18, 20, 8],
    ["rightForearm", 19, 21, 9],
    ["leftHand", 20, null, 10],
    ["rightHand", 21, null, 11],
    ["leftThigh", 1, 4, 0],
    ["rightThigh", 2, 5, 0],
    ["leftShin", 4, 7, 14],
    ["rightShin", 5, 8, 15],
    ["leftFoot", 7, 10, 16],
    ["rightFoot", 8, 11, 17],
  ];
  const NUMBER = Object.fromEntries(PIECES.map(([name], number) => [name, number]));
  const HAND_LENGTH = 0.17;
  const HEAD_HEIGHT = 0.16;

  const CELL = 0.0095; // metres between the samples from which the skin is made
  const MELTING = 85; // 1/metres: the larger, the sharper the creases between two cones
  const REACH = 0.032; // metres beyond a cone up to which it takes part

  const add = (a, b, scale = 1) => [a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]];
  const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const norm = (a) => Math.sqrt(dot(a, a));
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const mix = (a, b, t) => add(a, minus(b, a), t);

  function unit(a, otherwise = [0, 1, 0]) {
    const length = norm(a);
    return length > 1e-6 ? [a[0] / length, a[1] / length, a[2] / length] : otherwise;
  }

  /** Return both ends of a piece at rest. */
  function restEnds(number) {
    const [name, first, last] = PIECES[number];
    const start = REST[first];
    if (last !== null) return [start, REST[last]];
    if (name === "head") return [start, add(start, [0, HEAD_HEIGHT, 0])];
    const elbow = REST[PIECES[PIECES[number][3]][1]];
    return [start, add(start, unit(minus(start, elbow)), HAND_LENGTH)];
  }

  // Cross sections of the trunk from the seat to the collar bones: piece, height, half width, middle, radius; metres.
  const TRUNK = [
    ["pelvis", 0.862, 0.078, -0.01, 0.064],
    ["pelvis", 0.925, 0.086, -0.01, 0.066],
    ["waist", 1.0, 0.074, -0.006, 0.062],
    ["waist", 1.085, 0.063, -0.004, 0.06],
    ["ribs", 1.17, 0.07, -0.006, 0.066],
    ["chest", 1.26, 0.084, -0.008, 0.075],
    ["chest", 1.325, 0.09, -0.014, 0.072],
    ["chest", 1.375, 0.08, -0.026, 0.054],
    ["chest", 1.4, 0.066, -0.032, 0.042],
  ];

  /** Return lying capsules close enough to each other that no rib shows. */
  function trunk() {
    const rows = [];
    for (let index = 0; index + 1 < TRUNK.length; index += 1) {
      const [piece, y, halfWidth, z, radius] = TRUNK[index];
      const next = TRUNK[index + 1];
      const steps = Math.ceil((next[1] - y) / 0.016);
      for (let step = 0; step < steps; step += 1) {
        const t = step / steps;
        const at = (from, to) => from + t * (to - from);
        rows.push([
          t < 0.5 ? piece : next[0],
          at(halfWidth, next[2]),
          at(y, next[1]),
          at(z, next[3]),
          at(radius, next[4]),
        ]);
      }
    }
    return rows;
  }

  /**
   * Return the cones of which the skin is melted: [piece, one end, its radius, other end, its radius].
   *
   * Cones that lie close together swell where they melt, so radii here are up to 2 cm smaller than what is seen.
   */
  function cones() {
    const list = [];
    const cone = (piece, a, radiusA, b, radiusB) => list.push([NUMBER[piece], a, radiusA, b, radiusB]);
    const lying = (piece, halfWidth, y, z, radius) =>
      cone(piece, [-halfWidth, y, z], radius, [halfWidth, y, z], radius);

    for (const row of trunk()) lying(...row);
    cone("neck", [0, 1.42, -0.04], 0.058, [0, 1.54, 0.0], 0.05);

    // The head: skull, forehead, jaw, chin, nose and ears, around the joint at [0, 1.525, 0.012].
    cone("head", [0, 1.598, -0.022], 0.086, [0, 1.596, 0.022], 0.08);
    cone("head", [0, 1.55, 0.012], 0.062, [0, 1.52, 0.05], 0.04);
    cone("head", [0, 1.503, 0.062], 0.024, [0, 1.503, 0.058], 0.024);
    cone("head", [0, 1.585, 0.088], 0.008, [0, 1.554, 0.114], 0.0125);
    for (const side of [1, -1]) cone("head", [0.075 * side, 1.585, -0.008], 0.012, [0.077 * side, 1.558, 0.0], 0.009);

    for (const [side, left] of [
      ["left", true],
      ["right", false],
    ]) {
      const at = (joint) => REST[left ? joint : joint + 1]; // right joints follow their left twins
      const mirror = (point) => (left ? point : [-point[0], point[1], point[2]]);
      const [shoulder, elbow, wrist] = [at(16), at(18), at(20)];
      cone(`${side}Collar`, mirror([0.07, 1.395, -0.035]), 0.055, add(shoulder, [0, 0, 0]), 0.052);
      cone(`${side}UpperArm`, shoulder, 0.054, mix(shoulder, elbow, 0.45), 0.047);
      cone(`${side}UpperArm`, mix(shoulder, elbow, 0.4), 0.046, elbow, 0.037);
      cone(`${side}Forearm`, elbow, 0.037, mix(elbow, wrist, 0.3), 0.04);
      cone(`${side}Forearm`, mix(elbow, wrist, 0.3), 0.039, wrist, 0.025);

      // A mitten: the palm faces the thigh, the thumb points ahead.
      const along = unit(minus(wrist, elbow));
      const ahead = unit(
        minus(
          [0, 0, 1],
          along.map((value) => value * along[2]),
        ),
      );
      const hand = (forwards, sideways) => add(add(wrist, along, forwards), ahead, sideways);
      for (const [sideways, length] of [
        [0.021, 0.155],
        [0, 0.165],
        [-0.021, 0.15],
      ]) {
        cone(`${side}Hand`, hand(0.035, sideways * 0.8), 0.02, hand(0.09, sideways), 0.0165);
        cone(`${side}Hand`, hand(0.09, sideways), 0.0155, hand(length, sideways * 0.75), 0.0095);
      }
      cone(`${side}Hand`, hand(0.03, 0.02), 0.019, hand(0.085, 0.056), 0.0115);

      const [hip, knee, ankle, toe] = [at(1), at(4), at(7), at(10)];
      cone(`${side}Thigh`, add(hip, mirror([0.02, -0.01, 0])), 0.083, mix(hip, knee, 0.5), 0.072);
      cone(`${side}Thigh`, mix(hip, knee, 0.5), 0.071, knee, 0.05);
      cone("pelvis", add(hip, mirror([0.008, 0.0, -0.042])), 0.062, add(hip, mirror([0.012, 0.035, -0.036])), 0.056);
      cone(`${side}Shin`, knee, 0.049, mix(knee, ankle, 0.5), 0.045);
      cone(`${side}Shin`, mix(knee, ankle, 0.2), 0.04, add(mix(knee, ankle, 0.42), [0, 0, -0.02]), 0.045);
      cone(`${side}Shin`, mix(knee, ankle, 0.45), 0.045, ankle, 0.032);
      cone(`${side}Foot`, add(ankle, [0, -0.035, -0.025]), 0.036, add(ankle, [0, -0.01, 0.02]), 0.035);
      cone(`${side}Foot`, add(ankle, [0, -0.012, 0.02]), 0.034, add(toe, [0, 0.008, 0]), 0.032);
      const outwards = mirror([0.012, 0, 0]);
      cone(
        `${side}Foot`,
        add(add(toe, outwards), [0, 0.0, -0.02]),
        0.027,
        add(add(toe, outwards), [0, 0, 0.035]),
        0.022,
      );
      cone(
        `${side}Foot`,
        add(add(toe, outwards, -1.4), [0, 0, -0.02]),
        0.027,
        add(add(toe, outwards, -1), [0, 0, 0.05]),
        0.023,
      );
    }
    return list;
  }
  const SOLE = -0.004; // height at which the feet are cut flat

  /** Signed distance of a point to a cone with round ends, metres; the radius changes evenly along its axis. */
  function coneDistance(x, y, z, cone) {
    const [, a, radiusA, b, radiusB] = cone;
    const dx = b[0] - a[0];
    const dy = b[1] - a[1];
    const dz = b[2] - a[2];
    const px = x - a[0];
    const py = y - a[1];
    const pz = z - a[2];
    let t = (px * dx + py * dy + pz * dz) / (dx * dx + dy * dy + dz * dz);
    t = Math.min(Math.max(t, 0), 1);
    const ex = px - t * dx;
    const ey = py - t * dy;
    const ez = pz - t * dz;
    return Math.sqrt(ex * ex + ey * ey + ez * ez) - (radiusA + t * (radiusB - radiusA));
  }

  /**
   * Sample the melted cones on a grid.
   *
   * Returns the distance to the skin (negative inside; roughly, far from it) and the piece of the nearest cone.
   */
  function sampleBody() {
    const list = cones();
    const low = [-0.8, -0.04, -0.22];
    const size = [1.6, 1.78, 0.44].map((extent) => Math.ceil(extent / CELL) + 1);
    const [nx, ny, nz] = size;
    const sum = new Float32Array(nx * ny * nz);
    const nearest = new Float32Array(nx * ny * nz).fill(1);
    const piece = new Uint8Array(nx * ny * nz);
    for (const cone of list) {
      const [number, a, radiusA, b, radiusB] = cone;
      const pad = Math.max(radiusA, radiusB) + REACH;
      const from = [0, 1, 2].map((i) => Math.max(0, Math.floor((Math.min(a[i], b[i]) - pad - low[i]) / CELL)));
      const to = [0, 1, 2].map((i) => Math.min(size[i] - 1, Math.ceil((Math.max(a[i], b[i]) + pad - low[i]) / CELL)));
      for (let k = from[2]; k <= to[2]; k += 1) {
        for (let j = from[1]; j <= to[1]; j += 1) {
          for (let i = from[0]; i <= to[0]; i += 1) {
            const distance = coneDistance(low[0] + i * CELL, low[1] + j * CELL, low[2] + k * CELL, cone);
            if (distance > REACH) continue;
            const index = i + nx * (j + ny * k);
            sum[index] += Math.exp(-MELTING * distance);
            if (distance < nearest[index]) {
              nearest[index] = distance;
              piece[index] = number;
            }
          }
        }
      }
    }
    const distance = sum; // the same memory
    for (let index = 0; index < sum.length; index += 1) {
      const melted = -Math.log(Math.max(sum[index], 0.02)) / MELTING;
      const y = low[1] + (Math.floor(index / nx) % ny) * CELL;
      distance[index] = Math.max(melted, SOLE - y);
    }
    return { distance, piece, low, size };
  }

  /**
   * Lay a surface through the zero of a sampled distance (naive surface nets).
   *
   * Returns corner points, triangles and the piece of the nearest cone of each point.
   */
  function surfaceNet({ distance, piece, low, size }) {
    const [nx, ny, nz] = size;
    const steps = [1, nx, nx * ny];
    const cornerOf = (bits) => (bits & 1) * steps[0] + ((bits >> 1) & 1) * steps[1] + ((bits >> 2) & 1) * steps[2];
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map(cornerOf);
    const edges = [];
    for (let one = 0; one < 8; one += 1) {
      for (const bit of [1, 2, 4]) if (!(one & bit)) edges.push([one, one | bit]);
    }
    const pointOf = new Int32Array(nx * ny * nz).fill(-1);
    const points = [];
    const pieces = [];
    const triangles = [];
    for (let k = 1; k < nz - 1; k += 1) {
      for (let j = 1; j < ny - 1; j += 1) {
        for (let i = 1; i < nx - 1; i += 1) {
          const cell = i + nx * (j + ny * k);
          // A point stands in every cell that the surface cuts, in the middle of the cuts through the cell's edges.
          let inside = 0;
          for (let c = 0; c < 8; c += 1) if (distance[cell + corners[c]] < 0) inside |= 1 << c;
          if (inside === 0 || inside === 255) continue;
          let cuts = 0;
          const middle = [0, 0, 0];
          for (const [one, other] of edges) {
            if (((inside >> one) & 1) === ((inside >> other) & 1)) continue;
            const here = distance[cell + corners[one]];
            const t = here / (here - distance[cell + corners[other]]);
            for (let axis = 0; axis < 3; axis += 1) {
              const start = (one >> axis) & 1;
              middle[axis] += start + t * (((other >> axis) & 1) - start);
            }
            cuts += 1;
          }
          pointOf[cell] = pieces.length;
          points.push(
            low[0] + (i + middle[0] / cuts) * CELL,
            low[1] + (j + middle[1] / cuts) * CELL,
            low[2] + (k + middle[2] / cuts) * CELL,
          );
          pieces.push(piece[cell + corners[Math.log2(inside & -inside)]]);

          // Each grid edge that begins here and is cut joins the points of the four cells around it.
          for (let axis = 0; axis < 3; axis += 1) {
            const startsInside = distance[cell] < 0;
            if (startsInside === distance[cell + steps[axis]] < 0) continue;
            const u = steps[(axis + 1) % 3];
            const v = steps[(axis + 2) % 3];
            const [p, q, r, s] = [pointOf[cell], pointOf[cell - u], pointOf[cell - u - v], pointOf[cell - v]];
            if (startsInside) triangles.push(p, q, r, p, r, s);
            else triangles.push(p, r, q, p, s, r);
          }
        }
      }
    }
    return { points: new Float32Array(points), pieces, triangles: new Uint32Array(triangles) };
  }

  /** Move points onto the skin, and return its outward directions there: the slope of the sampled distance. */
  function settle(points, { distance, low, size }) {
    const [nx, ny] = size;
    const sample = (x, y, z) => {
      const i = Math.floor(x);
      const j = Math.floor(y);
      const k = Math.floor(z);
      const [u, v, w] = [x - i, y - j, z - k];
      const at = (a, b, c) => distance[i + a + nx * (j + b + ny * (k + c))];
      const plane = (c) =>
        (at(0, 0, c) * (1 - u) + at(1, 0, c) * u) * (1 - v) + (at(0, 1, c) * (1 - u) + at(1, 1, c) * u) * v;
      return plane(0) * (1 - w) + plane(1) * w;
    };
    const normals = new Float32Array(points.length);
    for (let p = 0; p < points.length; p += 3) {
      const g = [0, 1, 2].map((axis) => (points[p + axis] - low[axis]) / CELL);
      const slope = [
        sample(g[0] + 1, g[1], g[2]) - sample(g[0] - 1, g[1], g[2]),
        sample(g[0], g[1] + 1, g[2]) - sample(g[0], g[1] - 1, g[2]),
        sample(g[0], g[1], g[2] + 1) - sample(g[0], g[1], g[2] - 1),
      ];
      normals.set(unit(slope), p);
      // One step of Newton's way takes the point from the middle of its cell onto the skin.
      const steepness = norm(slope) / (2 * CELL);
      const away = Math.min(Math.max(sample(...g) / Math.max(steepness, 0.3), -CELL / 2), CELL / 2);
      for (let axis = 0; axis < 3; axis += 1) points[p + axis] -= away * normals[p + axis];
    }
    return normals;
  }

  /** Return the place of a point along a piece: 0 at its start, 1 at its end, and its distance to the axis. */
  function alongPiece(point, number) {
    const [start, end] = restEnds(number);
    const axis = minus(end, start);
    const t = dot(minus(point, start), axis) / dot(axis, axis);
    const foot = add(start, axis, Math.min(Math.max(t, 0), 1));
    return [t, norm(minus(point, foot))];
  }

  /** Return true if two pieces are one, or one carries the other. */
  function touch(one, other) {
    return one === other || PIECES[one][3] === other || PIECES[other][3] === one;
  }

  /**
   * Return how strongly each piece moves each point: (points x pieces).
   *
   * Near pieces share a point by their distance; what the cones cut sharply (armpits, groin) is then evened out along
   * the skin, so that it bends instead of tearing.
   */
  function skinWeights(points, pieces, triangles) {
    const count = pieces.length;
    const n = PIECES.length;
    let weights = new Float32Array(count * n);
    for (let p = 0; p < count; p += 1) {
      const point = [points[3 * p], points[3 * p + 1], points[3 * p + 2]];
      let total = 0;
      for (let number = 0; number < n; number += 1) {
        if (!touch(pieces[p], number)) continue;
        const [, distance] = alongPiece(point, number);
        const weight = 1 / (1e-9 + distance ** 8);
        weights[p * n + number] = weight;
        total += weight;
      }
      for (let number = 0; number < n; number += 1) weights[p * n + number] /= total;
    }
    for (let round = 0; round < 7; round += 1) {
      const sums = weights.slice();
      const counts = new Float32Array(count).fill(1);
      for (let t = 0; t < triangles.length; t += 3) {
        for (let side = 0; side < 3; side += 1) {
          const here = triangles[t + side];
          const there = triangles[t + ((side + 1) % 3)];
          counts[here] += 1;
          for (let number = 0; number < n; number += 1) sums[here * n + number] += weights[there * n + number];
        }
      }
      for (let p = 0; p < count; p += 1) {
        for (let number = 0; number < n; number += 1) sums[p * n + number] /= counts[p];
      }
      weights = sums;
    }
    return weights;
  }

  let geometry = null;

  /** Return the skin, shared by all bodies of a page; it is made when the first body needs it (about 0.3 s). */
  function skin() {
    if (geometry) return geometry;
    const samples = sampleBody();
    const { points, pieces, triangles } = surfaceNet(samples);
    const normals = settle(points, samples);
    const weights = skinWeights(points, pieces, triangles);
    const n = PIECES.length;
    const indices = new Uint16Array(4 * pieces.length);
    const strengths = new Float32Array(4 * pieces.length);
    const bands = new Float32Array(2 * pieces.length);
    for (let p = 0; p < pieces.length; p += 1) {
      // The graphics card blends four pieces a point: the strongest ones.
      const own = weights.subarray(p * n, (p + 1) * n);
      const order = [...own.keys()].sort((a, b) => own[b] - own[a]).slice(0, 4);
      const total = order.reduce((sum, number) => sum + own[number], 0);
      order.forEach((number, slot) => {
        indices[4 * p + slot] = number;
        strengths[4 * p + slot] = own[number] / total;
      });
      bands.set(bandPlace([points[3 * p], points[3 * p + 1], points[3 * p + 2]], pieces[p]), 2 * p);
    }
    geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
    geometry.setAttribute("normal", new THREE.BufferAttribute(normals, 3));
    geometry.setAttribute("skinIndex", new THREE.BufferAttribute(indices, 4));
    geometry.setAttribute("skinWeight", new THREE.BufferAttribute(strengths, 4));
    geometry.setAttribute("band", new THREE.BufferAttribute(bands, 2));
    geometry.setIndex(new THREE.BufferAttribute(triangles, 1));
    return geometry;
  }

  /** Return a point's place along an arm or leg (0 to 1 its upper, 1 to 2 its lower part), and 1 for a right one. */
  function bandPlace(point, number) {
    const name = PIECES[number][0];
    const right = name.startsWith("right") ? 1 : 0;
    const [t] = alongPiece(point, number);
    if (name.endsWith("UpperArm") || name.endsWith("Thigh")) return [t, right];
    if (name.endsWith("Forearm") || name.endsWith("Shin")) return [1 + t, right];
    return [name.endsWith("Hand") || name.endsWith("Foot") ? 2.5 : -0.5, 0];
  }

  // The skin's paint: rings on the right limbs, dark glasses, hair, and soles, so that sides and directions are seen
  // without colour. Places are those of the resting body, metres.
  const PAINT = `
    float ring(float place, float middle, float half_width) {
      float soft = max(fwidth(place), 1e-4);
      return smoothstep(half_width + soft, half_width - soft, abs(place - middle));
    }
    vec3 paint(vec3 base, vec3 rest, vec2 place, vec3 ringColour) {
      float band = place.x;
      float rings = max(max(ring(band, 0.5, 0.06), ring(band, 0.72, 0.06)), max(ring(band, 1.38, 0.06), ring(band, 1.6, 0.06)));
      base = mix(base, ringColour, rings * step(0.99, place.y));
      float soft = 0.0015;
      if (rest.y > 1.47 && abs(rest.x) < 0.12) {
        vec2 lens = vec2(abs(rest.x) - 0.033, rest.y - 1.588);
        float glasses = smoothstep(soft, -soft, length(lens * vec2(0.75, 1.0)) - 0.0205);
        glasses = max(glasses, smoothstep(soft, -soft, abs(rest.y - 1.592) - 0.005));
        glasses *= step(0.02, rest.z);
        float temple = smoothstep(soft, -soft, abs(rest.y - 1.592) - 0.0045) * step(-0.012, rest.z);
        base = mix(base, vec3(0.012, 0.014, 0.018), max(glasses, temple));
        float line = 1.632 + 0.55 * (rest.z - 0.075) * step(rest.z, 0.075);
        float hair = smoothstep(-soft, soft, rest.y - max(line, 1.545));
        base = mix(base, base * 0.42, hair);
      }
      float sole = smoothstep(soft, -soft, rest.y - 0.006);
      return mix(base, base * 0.35, sole);
    }`;

  /** Return the material of a body of one colour. */
  function bodyMaterial(colour, ringColour) {
    const material = new THREE.MeshStandardMaterial({ color: colour, roughness: 0.62, metalness: 0 });
    material.onBeforeCompile = (shader) => {
      shader.uniforms.ringColour = { value: ringColour };
      shader.vertexShader = shader.vertexShader
        .replace(
          "#include <common>",
          "#include <common>\nattribute vec2 band;\nvarying vec2 vBand;\nvarying vec3 vRest;",
        )
        .replace("#include <begin_vertex>", "#include <begin_vertex>\nvBand = band;\nvRest = position;");
      shader.fragmentShader = shader.fragmentShader
        .replace(
          "#include <common>",
          `#include <common>\nvarying vec2 vBand;\nvarying vec3 vRest;\nuniform vec3 ringColour;\n${PAINT}`,
        )
        .replace(
          "#include <color_fragment>",
          "#include <color_fragment>\ndiffuseColor.rgb = paint(diffuseColor.rgb, vRest, vBand, ringColour);",
        );
    };
    material.customProgramCacheKey = () => "prbench-body";
    return material;
  }

  /** Return the rotation (rows of a 3 x 3 matrix) whose second column is `y` and whose first is nearest to `x`. */
  function frameOf(y, x) {
    const up = unit(y);
    const across = unit(add(x, up, -dot(x, up)), [1, 0, 0]);
    const ahead = cross(across, up);
    return [across, up, ahead]; // columns
  }

  /** Return the turn that takes one frame of columns into another. */
  function turnBetween(from, to) {
    const rows = [];
    for (let row = 0; row < 3; row += 1) {
      rows.push(
        [0, 1, 2].map(
          (column) => to[0][row] * from[0][column] + to[1][row] * from[1][column] + to[2][row] * from[2][column],
        ),
      );
    }
    return rows;
  }

  const apply = (rows, vector) => rows.map((row) => dot(row, vector));

  /** Return `turn` followed by the shortest turn that takes the direction `from` into `to` (both unit). */
  function swing(turn, from, to) {
    const axis = cross(from, to);
    const cosine = dot(from, to);
    if (cosine < -0.9999) return turn; // opposite: no shortest way
    const k = 1 / (1 + cosine);
    const [x, y, z] = axis;
    const shortest = [
      [cosine + k * x * x, k * x * y - z, k * x * z + y],
      [k * x * y + z, cosine + k * y * y, k * y * z - x],
      [k * x * z - y, k * y * z + x, cosine + k * z * z],
    ];
    const columns = [0, 1, 2].map((c) => apply(shortest, [turn[0][c], turn[1][c], turn[2][c]]));
    return [0, 1, 2].map((row) => columns.map((column) => column[row]));
  }

  const REST_AXES = PIECES.map((_, number) => {
    const [start, end] = restEnds(number);
    return { start, axis: unit(minus(end, start)), length: norm(minus(end, start)) };
  });
  const SIDE = [1, 0, 0];

  /** Return how much larger or smaller than the resting body a pose is: the ratio of the summed limbs. */
  function sizeOf(joints) {
    let own = 0;
    let rest = 0;
    PIECES.forEach(([, first, last], number) => {
      if (last === null || number < 5) return;
      own += norm(minus(joints[last], joints[first]));
      rest += REST_AXES[number].length;
    });
    return Math.min(Math.max(own / rest, 0.5), 1.5);
  }

  /**
   * Compute the turn and stretch of every piece.
   *
   * Args:
   *   joints: 22 points, metres.
   *   headRay: Unit direction in which the head faces; zero where the pose has none.
   *   girth: Size of the body across its bones, 1 for the resting body.
   *   out: One THREE.Matrix4 a piece; maps places of the resting body to places of the pose.
   */
  function pose(joints, headRay, girth, out) {
    const hips = minus(joints[1], joints[2]);
    const shoulders = add(minus(joints[16], joints[17]), minus(joints[13], joints[14]));
    const between = add(unit(hips, SIDE), unit(shoulders, SIDE));
    const across = [hips, between, between, shoulders, shoulders];
    const turns = [];
    PIECES.forEach(([name, first, last, parent], number) => {
      const rest = REST_AXES[number];
      let turn;
      let stretch = girth;
      if (name === "head") {
        turn = turns[parent];
        if (norm(headRay) > 0.5) {
          const left = cross(unit(minus(joints[15], joints[12])), headRay);
          turn = turnBetween([SIDE, [0, 1, 0], [0, 0, 1]], frameOf(cross(headRay, unit(left, SIDE)), left));
        }
      } else if (last === null) {
        turn = turns[parent];
      } else {
        const bone = minus(joints[last], joints[first]);
        const direction = unit(bone, rest.axis);
        stretch = norm(bone) / rest.length;
        if (number < 5) turn = turnBetween(frameOf(rest.axis, SIDE), frameOf(direction, across[number]));
        else turn = swing(turns[parent], apply(turns[parent], rest.axis), direction);
      }
      turns.push(turn);
      // Scale by girth across the bone and by stretch along it, turn, and shift the bone's start to its joint.
      const a = rest.axis;
      const extra = stretch - girth;
      const scaled = [0, 1, 2].map((row) =>
        [0, 1, 2].map((column) => (row === column ? girth : 0) + extra * a[row] * a[column]),
      );
      const linear = turn.map((row) =>
        [0, 1, 2].map((c) => row[0] * scaled[0][c] + row[1] * scaled[1][c] + row[2] * scaled[2][c]),
      );
      const shift = minus(joints[first], apply(linear, rest.start));
      out[number].set(...linear[0], shift[0], ...linear[1], shift[1], ...linear[2], shift[2], 0, 0, 0, 1);
    });
  }

  /** One body in a scene: `object` to add, `pose` to move it, `paint` to colour it, `dispose` to free it. */
  class Body {
    constructor() {
      const bones = PIECES.map(() => {
        const bone = new THREE.Bone();
        bone.matrixAutoUpdate = false;
        bone.matrixWorldAutoUpdate = false;
        return bone;
      });
      this._skeleton = new THREE.Skeleton(
        bones,
        PIECES.map(() => new THREE.Matrix4()),
      );
      this._ringColour = new THREE.Color();
      this.material = bodyMaterial(new THREE.Color(), this._ringColour);
      this.object = new THREE.Group();
      this.mesh = this._mesh(this.material);
      this.mesh.castShadow = true;
      this.mesh.receiveShadow = true;
      // Translucent bodies first fill the depth, so that an arm before the trunk does not show through itself.
      this.depth = this._mesh(new THREE.MeshBasicMaterial({ colorWrite: false }));
      this.depth.visible = false;
      this.object.add(this.depth, this.mesh);
      this._girth = null;
    }

    _mesh(material) {
      const mesh = new THREE.SkinnedMesh(skin(), material);
      mesh.bindMode = "detached";
      mesh.bind(this._skeleton, new THREE.Matrix4());
      mesh.frustumCulled = false;
      return mesh;
    }

    /** Move to a pose: 22 points in metres and the unit direction of the head. */
    pose(joints, headRay) {
      if (this._girth === null) this._girth = sizeOf(joints);
      pose(
        joints,
        headRay,
        this._girth,
        this._skeleton.bones.map((bone) => bone.matrixWorld),
      );
    }

    /** Set colour and opacity (1: solid); `order` draws farther translucent bodies first. */
    paint(colour, ringColour, opacity, order) {
      this.material.color.set(colour);
      this._ringColour.set(ringColour);
      const translucent = opacity < 1;
      if (this.material.transparent !== translucent) this.material.needsUpdate = true;
      this.material.transparent = translucent;
      this.material.opacity = opacity;
      this.depth.visible = translucent;
      this.depth.renderOrder = order;
      this.mesh.renderOrder = order + 0.5;
      this.depth.material.transparent = translucent; // drawn in the same pass as the body, just before it
    }

    dispose() {
      this.material.dispose();
      this.depth.material.dispose();
      this._skeleton.dispose();
    }
  }

  parts.body = { Body, PIECES, restOf: restEnds, skin };
})();
