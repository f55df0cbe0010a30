// The 3D stage: bodies with their rays and paths, goal, objects, floor and shadows; camera and pictures.
//
// Nothing is drawn while nothing changes: every change calls `invalidate`, which asks for one frame.
(function () {
  "use strict";

  const prbench = (window.prbench = window.prbench || {});
  const parts = (prbench.playerParts = prbench.playerParts || {});

  // The lowest joint of a sequence lies on Y = 0; the soles of a body are this much below the joints of its toes.
  const FLOOR = -0.028;
  const BETWEEN_LANES = 0.9; // metres
  const LONGEST_RAY = 4.0; // metres, where no goal ends a ray
  const GAZE_COLOUR = "#e69f00";
  const GOAL_COLOUR = "#56b4e9";
  const BOX_EDGES = [
    [0, 1],
    [0, 2],
    [0, 4],
    [1, 3],
    [1, 5],
    [2, 3],
    [2, 6],
    [3, 7],
    [4, 5],
    [4, 6],
    [5, 7],
    [6, 7],
  ];
  const BOX_FACES = [
    [0, 1, 3, 2],
    [4, 6, 7, 5],
    [0, 4, 5, 1],
    [2, 3, 7, 6],
    [0, 2, 6, 4],
    [1, 5, 7, 3],
  ];
  const PELVIS = 0;
  const HEAD = 15;
  const WRISTS = [20, 21];
  const THEMES = {
    light: { back: "#eef1f4", fill: "#ffffff", line: "#8a94a0", shadow: 0.34, sky: 1.3, sun: 2.5, ink: "#1a1f26" },
    dark: { back: "#14181d", fill: "#262c34", line: "#66717e", shadow: 0.55, sky: 1.15, sun: 2.1, ink: "#e8ecf1" },
  };

  const up = () => new THREE.Vector3(0, 1, 0);

  /** Return the brightness of `#rrggbb` as the eye takes it, 0 to 1. */
  function luminance(colour) {
    const { r, g, b } = new THREE.Color(colour);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  }

  /** Return the colour in which a motion is painted: its own, but never nearly black, which would hide its form. */
  function paintOf(colour, dark) {
    const paint = new THREE.Color(colour);
    if (luminance(colour) < 0.06) paint.set(dark ? "#c9ced6" : "#767e89");
    else paint.lerp(new THREE.Color("#ffffff"), 0.12);
    return paint;
  }

  /** Free what a tree of objects holds on the graphics card; the skin is shared and stays. */
  function free(object) {
    object.traverse((node) => {
      if (node.isSkinnedMesh) return;
      if (node.geometry) node.geometry.dispose();
      if (node.material) node.material.dispose();
      if (node.isInstancedMesh) node.dispose();
    });
    object.removeFromParent();
  }

  /** Return a mesh of thin round bars between pairs of points. */
  function bars(pairs, radius, material) {
    const mesh = new THREE.InstancedMesh(new THREE.CylinderGeometry(radius, radius, 1, 8), material, pairs.length);
    mesh.frustumCulled = false;
    pairs.forEach(([from, to], number) => mesh.setMatrixAt(number, barMatrix(from, to)));
    return mesh;
  }

  const _along = { y: null };

  /** Return the transform that lays a cylinder of length 1 between two points. */
  function barMatrix(from, to) {
    if (!_along.y) _along.y = up();
    const a = new THREE.Vector3(...from);
    const b = new THREE.Vector3(...to);
    const length = Math.max(a.distanceTo(b), 1e-4);
    const turn = new THREE.Quaternion().setFromUnitVectors(_along.y, b.clone().sub(a).divideScalar(length));
    return new THREE.Matrix4().compose(a.add(b).multiplyScalar(0.5), turn, new THREE.Vector3(1, length, 1));
  }

  /** Return a box of eight corners: bars along its edges, and faint faces. */
  function boxObject(corners, colour, faceOpacity) {
    const group = new THREE.Group();
    const edges = new THREE.MeshStandardMaterial({ color: colour, roughness: 0.5 });
    const frame = bars(
      BOX_EDGES.map(([one, other]) => [corners[one], corners[other]]),
      0.0045,
      edges,
    );
    frame.castShadow = true;
    const faces = new THREE.BufferGeometry();
    faces.setAttribute("position", new THREE.BufferAttribute(new Float32Array(corners.flat()), 3));
    faces.setIndex(BOX_FACES.flatMap(([a, b, c, d]) => [a, b, c, a, c, d]));
    const glass = new THREE.MeshBasicMaterial({
      color: colour,
      transparent: true,
      opacity: faceOpacity,
      side: THREE.DoubleSide,
      depthWrite: false,
    });
    group.add(frame, new THREE.Mesh(faces, glass));
    return group;
  }

  /** Return a tube along a path whose triangles stand in the order of the frames, so that a part can be drawn. */
  function tube(points, radius, material) {
    const n = points.length / 3;
    const around = 6;
    const positions = new Float32Array(n * around * 3);
    const at = (i) => new THREE.Vector3(points[3 * i], points[3 * i + 1], points[3 * i + 2]);
    const forward = new THREE.Vector3(0, 0, 1);
    for (let i = 0; i < n; i += 1) {
      const step = at(Math.min(i + 1, n - 1)).sub(at(Math.max(i - 1, 0)));
      if (step.length() > 1e-5) forward.copy(step).normalize();
      const side = new THREE.Vector3()
        .crossVectors(Math.abs(forward.y) > 0.9 ? new THREE.Vector3(1, 0, 0) : up(), forward)
        .normalize();
      const top = new THREE.Vector3().crossVectors(forward, side);
      for (let k = 0; k < around; k += 1) {
        const angle = (2 * Math.PI * k) / around;
        const place = at(i)
          .addScaledVector(side, radius * Math.cos(angle))
          .addScaledVector(top, radius * Math.sin(angle));
        place.toArray(positions, 3 * (i * around + k));
      }
    }
    const index = [];
    for (let i = 0; i + 1 < n; i += 1) {
      for (let k = 0; k < around; k += 1) {
        const a = i * around + k;
        const b = i * around + ((k + 1) % around);
        index.push(a, b, a + around, b, b + around, a + around);
      }
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    geometry.setIndex(index);
    const mesh = new THREE.Mesh(geometry, material);
    mesh.frustumCulled = false;
    mesh.userData.indicesAFrame = around * 6;
    return mesh;
  }

  // Where the rooms of all stages are cut open: set before each picture is drawn.
  const cut = { middle: { value: null }, towards: { value: null }, depth: { value: 0 }, height: { value: 0 } };

  /** Return the material of a scene's mesh: what stands between camera and bodies is cut away, and so is the ceiling. */
  function roomMaterial() {
    const material = new THREE.MeshStandardMaterial({
      color: "#b9bdc4",
      roughness: 0.95,
      flatShading: true,
      side: THREE.DoubleSide,
    });
    material.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, {
        cutMiddle: cut.middle,
        cutTowards: cut.towards,
        cutDepth: cut.depth,
        cutHeight: cut.height,
      });
      shader.vertexShader = shader.vertexShader
        .replace("#include <common>", "#include <common>\nvarying vec3 vRoom;")
        .replace(
          "#include <begin_vertex>",
          "#include <begin_vertex>\nvRoom = (modelMatrix * vec4(position, 1.0)).xyz;",
        );
      shader.fragmentShader = shader.fragmentShader
        .replace(
          "#include <common>",
          "#include <common>\nvarying vec3 vRoom; uniform vec3 cutMiddle, cutTowards; uniform float cutDepth, cutHeight;",
        )
        .replace(
          "#include <clipping_planes_fragment>",
          "if (vRoom.y > cutHeight || (vRoom.y > 0.12 && dot(vRoom - cutMiddle, cutTowards) > cutDepth)) discard;",
        );
    };
    return material;
  }

  /** Return the path of one joint, metres. */
  function pathOf(motion, n, joint, height = null) {
    const path = new Float32Array(3 * n);
    for (let i = 0; i < n; i += 1) {
      path.set(motion.joints.subarray(66 * i + 3 * joint, 66 * i + 3 * joint + 3), 3 * i);
      if (height !== null) path[3 * i + 1] = height;
    }
    return path;
  }

  /** One motion on the stage, with its rays, paths, and its own copy of goal and objects. */
  class Actor {
    constructor(sequence, motion) {
      this.sequence = sequence;
      this.motion = motion;
      this.group = new THREE.Group();
      this.body = new parts.body.Body();
      this.group.add(this.body.object);
      this.joints = Array.from({ length: 22 }, () => [0, 0, 0]);
      this.ray = [0, 0, 1];
      this._addRays();
      this._addPaths();
      this._addSurroundings();
    }

    _addRays() {
      const rod = () => {
        const material = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.9 });
        const mesh = new THREE.Mesh(new THREE.CylinderGeometry(1, 1, 1, 10), material);
        mesh.frustumCulled = false;
        mesh.matrixAutoUpdate = false;
        this.group.add(mesh);
        return mesh;
      };
      this.headRay = rod();
      this.hit = new THREE.Mesh(new THREE.SphereGeometry(0.022, 16, 12), new THREE.MeshBasicMaterial());
      this.group.add(this.hit);
      if (!this.motion.gaze) return;
      // Dashes, so that eyes and head are told apart without colour.
      const dashes = new THREE.InstancedMesh(
        new THREE.CylinderGeometry(0.0055, 0.0055, 1, 8),
        new THREE.MeshBasicMaterial({ color: GAZE_COLOUR }),
        48,
      );
      dashes.frustumCulled = false;
      this.gazeRay = dashes;
      this.group.add(dashes);
    }

    _addPaths() {
      const n = this.sequence.nFrames;
      this.paths = new THREE.Group();
      this.group.add(this.paths);
      if (n < 2) return;
      const pelvis = pathOf(this.motion, n, PELVIS, FLOOR + 0.008);
      const tracks = [[pelvis, 0.009], ...WRISTS.map((joint) => [pathOf(this.motion, n, joint), 0.006])];
      for (const [points, radius] of tracks) {
        const ahead = tube(
          points,
          radius * 0.6,
          new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.28, depthWrite: false }),
        );
        const done = tube(points, radius, new THREE.MeshBasicMaterial());
        done.userData.done = true;
        this.paths.add(ahead, done);
      }
    }

    _addSurroundings() {
      const { goal, limits, objects, mesh } = this.sequence;
      this.goal = new THREE.Group();
      if (goal) {
        if (goal.box && goal.box.length === 8) this.goal.add(boxObject(goal.box, GOAL_COLOUR, 0.16));
        const dot = new THREE.Mesh(
          new THREE.SphereGeometry(0.018, 20, 14),
          new THREE.MeshStandardMaterial({ color: "#0b6fa4", roughness: 0.4 }),
        );
        dot.position.set(...goal.location);
        dot.castShadow = true;
        this.goal.add(dot);
        // A wrist inside the small sphere is within reach; a ray through the large one is on target.
        this.limits = new THREE.Group();
        for (const [radius, opacity] of [
          [limits.reach_distance, 0.2],
          [limits.prime_distance, 0.085],
        ]) {
          if (!radius) continue;
          const shell = new THREE.Mesh(
            new THREE.SphereGeometry(radius, 40, 28),
            new THREE.MeshBasicMaterial({ color: GOAL_COLOUR, transparent: true, opacity, depthWrite: false }),
          );
          shell.position.set(...goal.location);
          this.limits.add(shell);
        }
        this.goal.add(this.limits);
      }
      this.objects = new THREE.Group();
      for (const object of objects) {
        const shown = boxObject(object.box, "#8d6e97", 0.2);
        shown.userData.path = object.path;
        this.objects.add(shown);
      }
      this.scenery = new THREE.Group();
      if (mesh) {
        const geometry = new THREE.BufferGeometry();
        geometry.setAttribute("position", new THREE.BufferAttribute(mesh.vertices, 3));
        geometry.setIndex(new THREE.BufferAttribute(mesh.triangles, 1));
        const material = roomMaterial();
        const room = new THREE.Mesh(geometry, material);
        room.receiveShadow = true;
        this.scenery.add(room);
      }
      this.group.add(this.goal, this.objects, this.scenery);
    }

    /** Colour everything; `order` puts farther translucent bodies first. */
    paint(dark, opacity) {
      const paint = paintOf(this.motion.colour, dark);
      const bright = 0.2126 * paint.r + 0.7152 * paint.g + 0.0722 * paint.b > 0.3;
      this.body.paint(paint, bright ? "#1d2126" : "#ffffff", opacity, this.order || 0);
      for (const mesh of [this.headRay, this.hit, ...this.paths.children]) mesh.material.color.copy(paint);
    }

    /** Move everything to a time; between two frames, places are halfway between those of the frames. */
    setTime(time) {
      const { nFrames, fps } = this.sequence;
      const place = Math.min(Math.max(time * fps, 0), nFrames - 1);
      const before = Math.floor(place);
      const after = Math.min(before + 1, nFrames - 1);
      const t = place - before;
      const between = (values, width, offset, out) => {
        for (let i = 0; i < 3; i += 1) {
          const here = values[width * before + offset + i];
          out[i] = here + t * (values[width * after + offset + i] - here);
        }
        return out;
      };
      for (let joint = 0; joint < 22; joint += 1) between(this.motion.joints, 66, 3 * joint, this.joints[joint]);
      const ray = between(this.motion.headRay, 3, 0, [0, 0, 0]);
      const length = Math.hypot(...ray);
      this.ray = length > 1e-6 ? ray.map((value) => value / length) : [0, 0, 0];
      this.body.pose(this.joints, this.ray);
      this._moveHeadRay(before + (t >= 0.5 ? 1 : 0));
      if (this.gazeRay) this._moveGaze(between, before);
      for (const object of this.objects.children) {
        const path = object.userData.path;
        if (path) object.position.fromArray(between(path, 3, 0, [0, 0, 0])).sub(new THREE.Vector3().fromArray(path));
      }
      const drawn = Math.round(place);
      for (const path of this.paths.children) {
        if (path.userData.done) path.geometry.setDrawRange(0, drawn * path.userData.indicesAFrame);
      }
    }

    /** Return the end of a ray: beside the goal, or in the air where no goal is ahead. */
    _endOf(origin, direction) {
      let length = LONGEST_RAY;
      if (this.sequence.goal) {
        const ahead = this.sequence.goal.location.reduce(
          (sum, value, i) => sum + (value - origin[i]) * direction[i],
          0,
        );
        if (ahead > 0.05) length = Math.min(ahead, LONGEST_RAY);
        else length = 1;
      }
      return [origin.map((value, i) => value + length * direction[i]), length];
    }

    _moveHeadRay(frame) {
      const [end] = this._endOf(this.joints[HEAD], this.ray);
      const onTarget = parts.reading.inSpans(this.motion.onTarget, frame);
      const radius = onTarget ? 0.009 : 0.0045;
      this.headRay.matrix.copy(barMatrix(this.joints[HEAD], end)).scale(new THREE.Vector3(radius, 1, radius));
      this.headRay.material.opacity = onTarget ? 1 : 0.6;
      this.hit.position.set(...end);
      this.hit.scale.setScalar(onTarget ? 1 : 0.5);
    }

    _moveGaze(between, frame) {
      const { origin, direction, valid } = this.motion.gaze;
      const shown = valid[frame] === 1;
      let count = 0;
      if (shown) {
        const from = between(origin, 3, 0, [0, 0, 0]);
        const along = between(direction, 3, 0, [0, 0, 0]);
        const size = Math.hypot(...along) || 1;
        const unit = along.map((value) => value / size);
        const [, length] = this._endOf(from, unit);
        const at = (distance) => from.map((value, i) => value + distance * unit[i]);
        for (let start = 0.3; start < length && count < 48; start += 0.1) {
          this.gazeRay.setMatrixAt(count, barMatrix(at(start), at(Math.min(start + 0.06, length))));
          count += 1;
        }
      }
      this.gazeRay.count = count;
      this.gazeRay.instanceMatrix.needsUpdate = true;
    }

    dispose() {
      this.body.dispose();
      free(this.group);
    }
  }

  /** Return a round floor that carries shadows and a grid, and fades into whatever is behind it. */
  function makeFloor() {
    const material = new THREE.ShadowMaterial({ transparent: true, depthWrite: false });
    const uniforms = {
      fillColour: { value: new THREE.Color() },
      lineColour: { value: new THREE.Color() },
      fill: { value: 1 },
      middle: { value: new THREE.Vector3() },
      radius: { value: 6 },
    };
    material.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, uniforms);
      shader.vertexShader = shader.vertexShader
        .replace("#include <common>", "#include <common>\nvarying vec3 vFloor;")
        .replace(
          "#include <begin_vertex>",
          "#include <begin_vertex>\nvFloor = (modelMatrix * vec4(position, 1.0)).xyz;",
        );
      shader.fragmentShader = shader.fragmentShader
        .replace(
          "#include <common>",
          `#include <common>
          varying vec3 vFloor; uniform vec3 fillColour, lineColour, middle; uniform float fill, radius;
          float grid(vec2 place, float width) {
            vec2 soft = fwidth(place);
            vec2 away = abs(fract(place - 0.5) - 0.5);
            vec2 line = smoothstep(width + soft, max(width - soft, 0.0), away) * min(vec2(1.0), 0.6 / max(soft * 4.0, 0.6));
            return max(line.x, line.y);
          }`,
        )
        .replace("#include <opaque_fragment>", "")
        .replace(
          /gl_FragColor = vec4\( color, opacity \* \( 1\.0 - getShadowMask\(\) \) \);/,
          `float fade = smoothstep(1.0, 0.25, distance(vFloor.xz, middle.xz) / radius);
          float lines = max(0.75 * grid(vFloor.xz, 0.006), 0.25 * grid(vFloor.xz * 4.0, 0.01)) * fade;
          float dark = opacity * (1.0 - getShadowMask()) * smoothstep(1.0, 0.7, distance(vFloor.xz, middle.xz) / radius);
          float base = fill * fade;
          // Fill, then lines, then shadow, each laid over what is below it.
          vec3 below = mix(fillColour, lineColour, lines);
          float alpha = base + lines * (1.0 - base);
          float whole = dark + alpha * (1.0 - dark);
          gl_FragColor = vec4(mix(below, vec3(0.0), dark / max(whole, 1e-4)), whole);`,
        );
    };
    const floor = new THREE.Mesh(new THREE.CircleGeometry(1, 48).rotateX(-Math.PI / 2), material);
    floor.receiveShadow = true;
    floor.renderOrder = -10;
    floor.userData.uniforms = uniforms;
    return floor;
  }

  /** Return labels that stay in the picture and do not cover one another: a later one moves up, or down at the top. */
  function apart(labels, width, top) {
    const placed = [];
    for (const label of labels) {
      const half = 4.2 * label.label.length + 10;
      label.x = Math.min(Math.max(label.x, half), Math.max(width - half, half));
      label.y = Math.max(label.y, top);
      const covered = () =>
        placed.find(
          (other) =>
            Math.abs(other.x - label.x) < half + 4.2 * other.label.length + 10 && Math.abs(other.y - label.y) < 21,
        );
      let step = -21;
      for (let tries = 0; tries < 8 && covered(); tries += 1) {
        if (label.y + step < top) step = 21;
        label.y += step;
      }
      placed.push(label);
    }
    return placed;
  }

  /** The stage in an element. Raises an Error where the browser has no WebGL. */
  class Stage {
    constructor(element, { reducedMotion = false, onDraw = () => {} } = {}) {
      this.element = element;
      this.onDraw = onDraw;
      this.reducedMotion = reducedMotion;
      this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, powerPreference: "high-performance" });
      this.renderer.shadowMap.enabled = true;
      this.renderer.shadowMap.type = THREE.PCFShadowMap;
      this.renderer.shadowMap.autoUpdate = false; // turning the camera moves no shadow
      this.canvas = this.renderer.domElement;
      element.append(this.canvas);
      this.scene = new THREE.Scene();
      this.camera = new THREE.PerspectiveCamera(38, 1, 0.05, 80);
      this.target = new THREE.Vector3(); // what the camera looks at
      this._letGo = parts.hands.listen(this.canvas, {
        start: () => {
          this._flight = null;
        },
        turn: (across, down) => this.orbit(-across * 2 * Math.PI, -down * 2 * Math.PI),
        shift: (across, down) => this.shift(across, down),
        nearer: (factor) => this.orbit(0, 0, factor),
      });
      this.sky = new THREE.HemisphereLight("#ffffff", "#aab0b8", 1.5);
      this.sun = new THREE.DirectionalLight("#fff6e8", 2);
      this.sun.castShadow = true;
      this.sun.shadow.mapSize.set(2048, 2048);
      this.sun.shadow.radius = 3;
      this.sun.shadow.bias = -0.0005;
      this.sun.shadow.normalBias = 0.012;
      this.back = new THREE.DirectionalLight("#dfe9ff", 0.7);
      this.floor = makeFloor();
      this.scene.add(this.sky, this.sun, this.sun.target, this.back, this.back.target, this.floor);
      this.actors = [];
      this._leaving = [];
      this.layout = "lanes";
      this.layers = {};
      this.preset = "default";
      this.follow = false;
      this.dark = false;
      this.time = 0;
      this._observer = new ResizeObserver(() => this._resize());
      this._observer.observe(element);
      this.setTheme(false);
      this._resize();
    }

    /** Ask for one frame. */
    invalidate() {
      if (this._asked) return;
      this._asked = requestAnimationFrame((now) => {
        this._asked = null;
        this._fly(now);
        this.draw();
      });
    }

    _resize() {
      const { clientWidth, clientHeight } = this.element;
      if (!clientWidth || !clientHeight) return;
      this.renderer.setPixelRatio(this._ratio || Math.min(window.devicePixelRatio || 1, 2));
      this.renderer.setSize(clientWidth, clientHeight);
      this.canvas.style.width = "100%";
      this.canvas.style.height = "100%";
      if (this._fitted && !this._touched()) this.look(this.preset, false);
      this.invalidate();
    }

    /** Draw with more pixels for each of the page's, for a film; null: as the screen wants. */
    sharpen(ratio) {
      this._ratio = ratio;
      this._resize();
    }

    /** Return true if the user has turned the camera away from its preset. */
    _touched() {
      return this._lookedFrom && this.camera.position.distanceTo(this._lookedFrom) > 1e-3 && !this.follow;
    }

    /** Put the motions of a sequence on the stage; `labels` names the ones to show, in any order. */
    show(sequence, labels) {
      this.clear();
      this.sequence = sequence;
      for (const motion of sequence.motions) {
        const actor = new Actor(sequence, motion);
        actor.shown = labels.includes(motion.label);
        this.actors.push(actor);
        this.scene.add(actor.group);
      }
      this.arrange();
      this.setTime(0);
      this.look(this.preset, false);
    }

    /** Take all motions off; what they hold is freed after the next frame, which may use the same programs. */
    clear() {
      for (const actor of this.actors) actor.group.removeFromParent();
      this._leaving.push(...this.actors);
      this.renderer.shadowMap.needsUpdate = true;
      this.actors = [];
      this.sequence = null;
      this._fitted = false;
    }

    get shown() {
      return this.actors.filter((actor) => actor.shown);
    }

    /** Show the motions with these labels. */
    choose(labels) {
      for (const actor of this.actors) actor.shown = labels.includes(actor.motion.label);
      this.arrange();
      this.setTime(this.time);
      this.look(this.preset, false);
    }

    /** Lay the motions out: "lanes" side by side, "overlay" at one place, or "views", each in a picture of its own. */
    setLayout(layout) {
      this.layout = layout;
      if (!this.actors.length) return;
      this.arrange();
      this.setTime(this.time);
      this.look(this.preset, false);
    }

    /** Show or hide kinds of things: `head`, `gaze`, `paths`, `limits`, `objects`, `scenery`, `labels`. */
    setLayers(layers) {
      this.layers = { ...layers };
      this.arrange();
      this.invalidate();
    }

    /** Horizontal unit direction from where the first body ends to the goal: the reach is seen across it. */
    get axis() {
      const { motion } = this.actors[0];
      const n = this.sequence.nFrames;
      const last = 66 * (n - 1);
      const to = this.sequence.goal ? this.sequence.goal.location : [motion.joints[last], 0, motion.joints[last + 2]];
      const from = this.sequence.goal ? motion.joints.subarray(last, last + 3) : motion.joints.subarray(0, 3);
      const axis = new THREE.Vector3(to[0] - from[0], 0, to[2] - from[2]);
      return axis.length() > 0.05 ? axis.normalize() : new THREE.Vector3(0, 0, 1);
    }

    /** Place lanes, and decide what of every motion is visible and how solid it is. */
    arrange() {
      if (!this.actors.length) return;
      const shown = this.shown;
      // Seen from the side the lanes follow one another, or the first body would cover the others.
      const across = this.preset === "side" ? this.axis.negate() : new THREE.Vector3().crossVectors(this.axis, up());
      const spread = (actor) => {
        const goal = this.sequence.goal ? this.sequence.goal.location : [0, 0, 0];
        let least = Math.min(0, goal[0] * across.x + goal[2] * across.z);
        let most = Math.max(0, goal[0] * across.x + goal[2] * across.z);
        for (let i = 0; i < this.sequence.nFrames; i += 1) {
          const from = 66 * i;
          const place = actor.motion.joints[from] * across.x + actor.motion.joints[from + 2] * across.z;
          least = Math.min(least, place);
          most = Math.max(most, place);
        }
        return [least, most];
      };
      let edge = 0;
      for (const [number, actor] of shown.entries()) {
        const [least, most] = spread(actor);
        if (number > 0) edge += BETWEEN_LANES / 2 - least;
        const lane = this.layout === "lanes" ? edge : 0;
        edge += most + BETWEEN_LANES / 2;
        actor.group.position.copy(across).multiplyScalar(lane);
      }
      const on = (layer) => this.layers[layer] !== false;
      for (const actor of this.actors) {
        const number = shown.indexOf(actor);
        const copies = this.layout !== "overlay" || number === 0;
        actor.group.visible = actor.shown;
        actor.headRay.visible = on("head");
        actor.hit.visible = on("head") && Boolean(this.sequence.goal);
        if (actor.gazeRay) actor.gazeRay.visible = on("gaze");
        actor.paths.visible = on("paths");
        actor.goal.visible = copies;
        if (actor.limits) actor.limits.visible = on("limits");
        actor.objects.visible = copies && on("objects");
        actor.scenery.visible = on("scenery") && (this.layout === "views" || number === 0);
        actor.opacity = this.layout === "overlay" && shown.length > 1 ? (number === 0 ? 0.85 : 0.6) : 1;
        actor.paint(this.dark, actor.opacity);
      }
      this.floor.visible = !(this.sequence.mesh && on("scenery"));
      this._bounds = this._boundsOf(shown);
      this._light();
      this.renderer.shadowMap.needsUpdate = true;
    }

    /** Return the middle and size of the ground that bodies and goal take, all frames together. */
    _boundsOf(actors) {
      const low = new THREE.Vector3(Infinity, FLOOR, Infinity);
      const high = new THREE.Vector3(-Infinity, 1.75, -Infinity);
      const take = (x, y, z) => {
        low.set(Math.min(low.x, x), Math.min(low.y, y), Math.min(low.z, z));
        high.set(Math.max(high.x, x), Math.max(high.y, y), Math.max(high.z, z));
      };
      for (const { motion, group } of actors) {
        for (let i = 0; i < motion.joints.length; i += 3) {
          take(motion.joints[i] + group.position.x, motion.joints[i + 1], motion.joints[i + 2] + group.position.z);
        }
        if (this.sequence.goal) {
          const [x, y, z] = this.sequence.goal.location;
          take(x + group.position.x, y, z + group.position.z);
        }
      }
      if (low.x > high.x) take(0, 0, 0);
      const middle = low.clone().add(high).multiplyScalar(0.5);
      return { low, high, middle, radius: high.clone().sub(low).length() / 2 };
    }

    _light() {
      const { middle, radius } = this._bounds;
      const ground = new THREE.Vector3(middle.x, 0, middle.z);
      this.sun.target.position.copy(ground);
      this.sun.position.copy(ground).add(new THREE.Vector3(2.2, 5.2, 2.6).multiplyScalar(Math.max(1, radius / 3)));
      this.back.target.position.copy(ground);
      this.back.position.copy(ground).add(new THREE.Vector3(-3, 2.5, -4));
      const box = this.sun.shadow.camera;
      const half = radius + 0.8;
      Object.assign(box, { left: -half, right: half, top: half, bottom: -half, near: 0.1, far: 14 + 3 * radius });
      box.updateProjectionMatrix();
      const reach = radius + 5;
      this.floor.position.set(middle.x, FLOOR, middle.z);
      this.floor.scale.setScalar(reach);
      this.floor.userData.uniforms.middle.value.copy(ground);
      this.floor.userData.uniforms.radius.value = reach;
    }

    setTheme(dark) {
      this.dark = dark;
      const theme = THEMES[dark ? "dark" : "light"];
      this.theme = theme;
      this.renderer.setClearColor(theme.back, 1);
      const uniforms = this.floor.userData.uniforms;
      uniforms.fillColour.value.set(theme.fill);
      uniforms.lineColour.value.set(theme.line);
      this.floor.material.opacity = theme.shadow;
      this.sky.intensity = theme.sky;
      this.sun.intensity = theme.sun;
      for (const actor of this.actors) actor.paint(dark, actor.opacity);
      this.invalidate();
    }

    setTime(time) {
      this.time = time;
      this.renderer.shadowMap.needsUpdate = true;
      for (const actor of this.actors) if (actor.shown) actor.setTime(time);
      const here = this._follows();
      if (this.follow && this._followed && here && this.preset !== "eyes") {
        const step = here.clone().sub(this._followed);
        this.camera.position.add(step);
        this.target.add(step);
        if (this._lookedFrom) this._lookedFrom.add(step);
      }
      this._followed = here;
      this.invalidate();
    }

    /** Return the place on the ground between the shown bodies. */
    _follows() {
      const shown = this.shown;
      if (!shown.length) return null;
      const sum = new THREE.Vector3();
      for (const { joints, group } of shown)
        sum.add(new THREE.Vector3(joints[PELVIS][0], 0, joints[PELVIS][2])).add(group.position);
      return sum.divideScalar(shown.length);
    }

    setFollow(follow) {
      this.follow = follow;
      this.look(this.preset, true);
    }

    /** Look from a preset place: "default", "side", "front", "above", or "eyes" (through the head). */
    look(preset, animated = true) {
      const newLanes = (preset === "side") !== (this.preset === "side");
      this.preset = preset;
      this.camera.fov = preset === "eyes" ? 80 : 38;
      if (!this.actors.length) return;
      if (newLanes) this.arrange();
      this._fitted = true;
      if (preset === "eyes") {
        this._flight = null;
        this.invalidate();
        return;
      }
      const axis = this.axis;
      const side = new THREE.Vector3().crossVectors(axis, up());
      // Several lanes are seen more from ahead, so that they spread over the picture.
      const lanes = this.layout === "lanes" && this.shown.length > 1;
      const [ahead, beside] = lanes ? [0.85, 0.55] : [0.62, 0.85];
      const towards = {
        default: axis
          .clone()
          .multiplyScalar(ahead)
          .addScaledVector(side, -beside)
          .add(new THREE.Vector3(0, 0.3, 0)),
        side: side
          .clone()
          .multiplyScalar(-1)
          .add(new THREE.Vector3(0, 0.07, 0)),
        front: axis.clone().add(new THREE.Vector3(0, 0.12, 0)),
        above: up().addScaledVector(axis, -0.001),
      }[preset].normalize();
      const [middle, distance] = this._fit(towards);
      if (preset !== "above") middle.y -= 0.035 * distance; // buttons cover the foot of the picture
      this._goTo(middle.clone().addScaledVector(towards, distance), middle, animated);
    }

    /** Return where to look and from how far, so that the bodies fill the picture. */
    _fit(towards) {
      const views = this.layout === "views" ? Math.max(this.shown.length, 1) : 1;
      const { clientWidth, clientHeight } = this.element;
      const columns = clientWidth >= clientHeight ? views : 1;
      const aspect = clientWidth / columns / (clientHeight / (views / columns)) || 1;
      let { low, high } = this._bounds;
      if (this.follow && this._follows()) {
        const shown = this.shown;
        low = new THREE.Vector3(Infinity, FLOOR, Infinity);
        high = new THREE.Vector3(-Infinity, 1.75, -Infinity);
        for (const { joints, group } of shown) {
          low.min(
            new THREE.Vector3(joints[0][0] - 0.5 + group.position.x, FLOOR, joints[0][2] - 0.5 + group.position.z),
          );
          high.max(
            new THREE.Vector3(joints[0][0] + 0.5 + group.position.x, 1.75, joints[0][2] + 0.5 + group.position.z),
          );
        }
      }
      const middle = low.clone().add(high).multiplyScalar(0.5);
      // The farthest corner of the bounding box decides, seen from this direction.
      const right = new THREE.Vector3().crossVectors(up(), towards).normalize();
      const top = new THREE.Vector3().crossVectors(towards, right);
      const tangent = Math.tan((38 * Math.PI) / 360);
      let distance = 1.2;
      for (let corner = 0; corner < 8; corner += 1) {
        const place = new THREE.Vector3(
          corner & 1 ? high.x : low.x,
          corner & 2 ? high.y : low.y,
          corner & 4 ? high.z : low.z,
        ).sub(middle);
        const depth = place.dot(towards);
        const wide = (Math.abs(place.dot(right)) + 0.2) / (tangent * aspect);
        const tall = (Math.abs(place.dot(top)) + 0.12) / tangent;
        distance = Math.max(distance, Math.max(wide, tall) + depth);
      }
      return [middle, distance * 1.04];
    }

    _goTo(position, target, animated) {
      this._lookedFrom = position.clone();
      if (!animated || this.reducedMotion) {
        this._flight = null;
        this.camera.position.copy(position);
        this.target.copy(target);
        this.camera.lookAt(this.target);
      } else {
        this._flight = {
          begin: null,
          from: this.camera.position.clone(),
          fromTarget: this.target.clone(),
          position,
          target,
        };
      }
      this.invalidate();
    }

    _fly(now) {
      const flight = this._flight;
      if (!flight) return;
      flight.begin = flight.begin === null ? now : flight.begin;
      const t = Math.min((now - flight.begin) / 350, 1);
      const eased = t * t * (3 - 2 * t);
      this.camera.position.lerpVectors(flight.from, flight.position, eased);
      this.target.lerpVectors(flight.fromTarget, flight.target, eased);
      this.camera.lookAt(this.target);
      if (t < 1) this.invalidate();
      else this._flight = null;
    }

    /** Turn the camera about what it looks at (radians), or come nearer (`nearer` < 1). */
    orbit(yaw, pitch, nearer = 1) {
      if (this.preset === "eyes") return;
      const offset = this.camera.position.clone().sub(this.target);
      const radius = Math.min(Math.max(offset.length() * nearer, 0.5), 25);
      const angle = Math.atan2(offset.x, offset.z) + yaw;
      const polar = Math.min(Math.max(Math.acos(offset.y / offset.length()) + pitch, 0.02), Math.PI * 0.52);
      offset.set(
        radius * Math.sin(polar) * Math.sin(angle),
        radius * Math.cos(polar),
        radius * Math.sin(polar) * Math.cos(angle),
      );
      this.camera.position.copy(this.target).add(offset);
      this.camera.lookAt(this.target);
      this.invalidate();
    }

    /** Shift the picture by shares of its height. */
    shift(across, down) {
      if (this.preset === "eyes") return;
      const size = 2 * Math.tan((this.camera.fov * Math.PI) / 360) * this.camera.position.distanceTo(this.target);
      const right = new THREE.Vector3().setFromMatrixColumn(this.camera.matrix, 0);
      const top = new THREE.Vector3().setFromMatrixColumn(this.camera.matrix, 1);
      const step = right.multiplyScalar(-across * size).addScaledVector(top, down * size);
      this.camera.position.add(step);
      this.target.add(step);
      this.invalidate();
    }

    /** Stand in the eyes of an actor. */
    _standIn(actor) {
      const { joints, ray, group } = actor;
      const head = new THREE.Vector3(...joints[HEAD]).add(group.position);
      const ahead = new THREE.Vector3(...ray);
      const neck = new THREE.Vector3(...joints[12]).add(group.position);
      const left = new THREE.Vector3().crossVectors(head.clone().sub(neck), ahead).normalize();
      const top = new THREE.Vector3().crossVectors(ahead, left);
      this.camera.position.copy(head).addScaledVector(top, 0.06).addScaledVector(ahead, 0.13);
      this.camera.up.copy(top);
      this.camera.lookAt(this.camera.position.clone().add(ahead));
      this.camera.up.set(0, 1, 0);
    }

    /** Return the rectangles into which the picture is divided: one, or one a motion. */
    _tiles(width, height) {
      const shown = this.shown;
      if (this.layout !== "views" || shown.length < 2) return [{ x: 0, y: 0, width, height, actors: shown }];
      const columns = width >= height ? shown.length : 1;
      const rows = shown.length / columns;
      return shown.map((actor, number) => ({
        x: columns > 1 ? (number * width) / columns : 0,
        y: columns > 1 ? 0 : (number * height) / rows,
        width: width / columns,
        height: height / rows,
        actors: [actor],
      }));
    }

    draw() {
      if (!this.actors.length && !this._leaving.length) return;
      const { clientWidth: width, clientHeight: height } = this.element;
      if (!width || !height) return;
      this._render(width, height);
      for (const actor of this._leaving.splice(0)) actor.dispose();
      this.onDraw(this.labels(width, height));
    }

    /** Draw into the canvas of the renderer, tile by tile. */
    _render(width, height) {
      this._sortTranslucent();
      const tiles = this._tiles(width, height);
      this.renderer.setScissorTest(tiles.length > 1);
      for (const tile of tiles) {
        for (const actor of this.actors) actor.group.visible = tile.actors.includes(actor);
        const fromBelow = height - tile.y - tile.height;
        this.renderer.setViewport(tile.x, fromBelow, tile.width, tile.height);
        this.renderer.setScissor(tile.x, fromBelow, tile.width, tile.height);
        this.camera.aspect = tile.width / tile.height;
        this.camera.updateProjectionMatrix();
        if (tiles.length > 1) this.renderer.shadowMap.needsUpdate = true;
        const seer = this.preset === "eyes" ? tile.actors[this.eyes % tile.actors.length] : null;
        this._cutRooms(Boolean(seer));
        // The own head ray would fill the eyes' picture: only its end is seen.
        if (seer) {
          this._standIn(seer);
          seer.headRay.visible = false;
          // Bodies that stand at one place would stand in each other's eyes.
          for (const actor of this.actors)
            actor.group.visible = actor.group.visible && (this.layout !== "overlay" || actor === seer);
        }
        this.renderer.render(this.scene, this.camera);
        if (seer) seer.headRay.visible = this.layers.head !== false;
      }
      this.renderer.setScissorTest(false);
      for (const actor of this.actors) actor.group.visible = actor.shown;
    }

    /** Say where rooms are cut open for the camera; nowhere for the eyes of a body. */
    _cutRooms(through) {
      const { low, high, middle } = this._bounds;
      const towards = this.camera.position.clone().sub(middle).setY(0);
      const flat = towards.length() / Math.max(this.camera.position.distanceTo(middle), 1e-3);
      towards.normalize();
      cut.middle.value = middle;
      cut.towards.value = towards;
      // Bodies keep what is within 40 cm of them; from above nothing but the ceiling is in the way.
      const half = (Math.abs(towards.x) * (high.x - low.x) + Math.abs(towards.z) * (high.z - low.z)) / 2;
      cut.depth.value = through || flat < 0.2 ? 1e6 : half + 0.4;
      cut.height.value = through ? 1e6 : 2.1;
    }

    /** Draw farther translucent bodies first, so that they show through the nearer ones. */
    _sortTranslucent() {
      if (this.layout !== "overlay") return;
      const away = (actor) => this.camera.position.distanceTo(new THREE.Vector3(...actor.joints[PELVIS]));
      const sorted = this.shown.sort((a, b) => away(b) - away(a));
      sorted.forEach((actor, number) => {
        actor.order = 2 * number;
        actor.paint(this.dark, actor.opacity);
      });
    }

    /** Return the name of every motion with its place in the picture, pixels of the page, none above `top`. */
    labels(width, height, top = 24) {
      if (this.layers.labels === false) return [];
      const labels = [];
      for (const tile of this._tiles(width, height)) {
        for (const actor of tile.actors) {
          const { label } = actor.motion;
          if (this.layout === "views" || this.preset === "eyes") {
            if (
              this.preset === "eyes" &&
              tile.actors.length > 1 &&
              actor !== tile.actors[this.eyes % tile.actors.length]
            )
              continue;
            labels.push({ label, x: tile.x + tile.width / 2, y: tile.y + 26 });
            continue;
          }
          const place = new THREE.Vector3(...actor.joints[HEAD]).add(actor.group.position);
          place.y += 0.26;
          place.project(this.camera);
          if (place.z > 1) continue;
          labels.push({
            label,
            x: tile.x + ((place.x + 1) / 2) * tile.width,
            y: tile.y + ((1 - place.y) / 2) * tile.height,
          });
        }
      }
      return apart([...labels, ...this._objectLabels(width, height)], width, top);
    }

    /** Return the names of the objects beside the first motion, where they are few enough to be read. */
    _objectLabels(width, height) {
      const [actor] = this.shown;
      const objects = this.sequence ? this.sequence.objects : [];
      if (!actor || this.layers.objects === false || objects.length > 12 || this.preset === "eyes") return [];
      const [tile] = this._tiles(width, height);
      return objects.flatMap(({ name, box }, number) => {
        const place = new THREE.Vector3();
        for (const corner of box) place.add(new THREE.Vector3(...corner).divideScalar(box.length));
        place.add(actor.objects.children[number].position).add(actor.group.position).project(this.camera);
        const x = tile.x + ((place.x + 1) / 2) * tile.width;
        const y = tile.y + ((1 - place.y) / 2) * tile.height + 24;
        const seen = place.z < 1 && x > tile.x && x < tile.x + tile.width && y > 0 && y < tile.y + tile.height;
        return seen ? [{ label: name, x, y, quiet: true }] : [];
      });
    }

    /**
     * Draw a picture of the stage, larger than it is on the page.
     *
     * Args:
     *   scale: Pixels of the picture for each pixel of the page.
     *   background: A colour, or null for a transparent one, over which shadow and grid remain.
     *   paint: Called with the 2D context, width and height (pixels of the page) to add labels.
     */
    picture({ scale = 2, background = null, paint = () => {} }) {
      const { clientWidth: width, clientHeight: height } = this.element;
      const fill = this.floor.userData.uniforms.fill;
      const before = this.renderer.getPixelRatio();
      this.renderer.setPixelRatio(scale);
      this.renderer.setSize(width, height, false);
      this.renderer.setClearColor(background || "#000000", background ? 1 : 0);
      if (background !== this.theme.back) fill.value = 0;
      this._render(width, height);
      const canvas = document.createElement("canvas");
      canvas.width = this.canvas.width;
      canvas.height = this.canvas.height;
      const context = canvas.getContext("2d");
      context.drawImage(this.canvas, 0, 0);
      fill.value = 1;
      this.renderer.setPixelRatio(before);
      this.renderer.setSize(width, height, false);
      this.renderer.setClearColor(this.theme.back, 1);
      this.draw();
      context.scale(scale, scale);
      paint(context, width, height);
      return canvas;
    }

    dispose() {
      this.clear();
      for (const actor of this._leaving) actor.dispose();
      if (this._asked) cancelAnimationFrame(this._asked);
      this._observer.disconnect();
      this._letGo();
      free(this.floor);
      this.sun.dispose();
      this.renderer.dispose();
      this.renderer.forceContextLoss();
      this.canvas.remove();
    }
  }
  Stage.prototype.eyes = 0; // number of the motion through whose eyes the camera looks

  parts.stage = { Stage, paintOf };
})();
