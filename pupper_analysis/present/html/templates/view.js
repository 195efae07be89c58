"use strict";
(() => {
  const THREE = window.MeshCat && window.MeshCat.THREE;
  const stages = [...document.querySelectorAll(".stage")];
  const said = () => window.report.words();
  if (!THREE) {
    for (const stage of stages) stage.querySelector(".hint").textContent = said().no_library;
    return;
  }
  const meshes = JSON.parse(document.getElementById("meshes").textContent);
  const MOST = 8; // largest number of WebGL contexts; some browsers drop the oldest above 16
  const active = [];
  const cache = new Map();
  const up = new THREE.Vector3(0, 0, 1);

  function bytes(text) {
    const raw = atob(text);
    const array = new Uint8Array(raw.length);
    for (let index = 0; index < raw.length; index++) array[index] = raw.charCodeAt(index);
    return array.buffer;
  }

  function meshOf(name) {
    if (cache.has(name)) return cache.get(name);
    const { low, span, vertices, faces, wide } = meshes[name];
    const steps = new Uint16Array(bytes(vertices));
    const places = new Float32Array(steps.length);
    for (let index = 0; index < steps.length; index++)
      places[index] = low[index % 3] + span[index % 3] * steps[index] / 65535;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(places, 3));
    const numbers = wide ? new Uint32Array(bytes(faces)) : new Uint16Array(bytes(faces));
    geometry.setIndex(new THREE.BufferAttribute(numbers, 1));
    cache.set(name, geometry);
    return geometry;
  }

  function shapes(geom) {
    const [a, b, c] = geom.size;
    const upright = (length, radius) =>
      new THREE.CylinderGeometry(radius, radius, length, 24).rotateX(Math.PI / 2);
    const ball = (radius) => new THREE.SphereGeometry(radius, 24, 16);
    switch (geom.shape) {
      case "sphere": return [ball(a)];
      case "capsule":
        return [upright(2 * b, a), ball(a).translate(0, 0, b), ball(a).translate(0, 0, -b)];
      case "ellipsoid": return [ball(1).scale(a, b, c)];
      case "cylinder": return [upright(2 * b, a)];
      case "box": return [new THREE.BoxGeometry(2 * a, 2 * b, 2 * c)];
      default: return [meshOf(geom.mesh)];
    }
  }

  const quaternion = ([w, x, y, z]) => new THREE.Quaternion(x, y, z, w);
  const vector = (values) => new THREE.Vector3(...values);
  const color = (name) =>
    new THREE.Color(getComputedStyle(document.documentElement).getPropertyValue(name).trim());

  class View {
    constructor(stage) {
      this.stage = stage;
      this.box = stage.querySelector(".canvas");
      this.hintLine = stage.querySelector(".hint");
      this.hint = this.hintLine.innerHTML;
      this.data = JSON.parse(stage.querySelector("script.scene").textContent);
      this.motion = 0;
      this.frame = 0;
      this.lit = -1;
      this.home();
      this.listen();
    }

    home() {
      const { middle, radius } = this.data;
      this.azimuth = -0.9;
      this.elevation = 0.35;
      this.target = vector(middle);
      this.distance = 2.8 * radius;
    }

    start() {
      if (this.renderer || this.broken) return;
      const trial = document.createElement("canvas");
      try { // test for a context first: without one, three.js writes errors to the console
        if (!(trial.getContext("webgl2") || trial.getContext("webgl"))) throw new Error("none");
        this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true,
          preserveDrawingBuffer: true });
      } catch (error) {
        this.broken = true;
        this.hintLine.textContent = said().no_webgl;
        return;
      }
      active.push(this);
      if (active.length > MOST) active[0].stop();
      this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
      this.camera = new THREE.PerspectiveCamera(40, 1, 0.01 * this.data.size, 60 * this.data.size);
      this.camera.up.copy(up);
      this.box.append(this.renderer.domElement);
      this.build();
      this.resize();
    }

    stop() {
      active.splice(active.indexOf(this), 1);
      this.renderer.domElement.remove();
      this.renderer.dispose();
      this.renderer.forceContextLoss();
      this.renderer = null;
    }

    build() {
      const data = this.data;
      const scene = this.scene = new THREE.Scene();
      scene.add(new THREE.HemisphereLight(0xffffff, 0x667788, 0.75));
      const sun = new THREE.DirectionalLight(0xffffff, 0.6);
      sun.position.set(1, -1.5, 3);
      scene.add(sun);
      this.layers = {};
      for (const name of ["shapes", "axes", "forces", "support", "masses"]) this.layers[name] = [];
      this.bodies = data.bodies.map(() => {
        const group = new THREE.Group();
        scene.add(group);
        return group;
      });
      this.targets = [];
      this.addShapes();
      this.addAxes();
      this.addMasses();
      this.addForces();
      this.addSupport();
      this.place();
      for (const input of this.stage.querySelectorAll("[data-layer]")) this.show(input);
    }

    put(layer, object, parent, index, kind) {
      this.layers[layer].push(object);
      (parent || this.scene).add(object);
      if (kind) {
        object.userData = { kind, index };
        this.targets.push(object);
      }
    }

    addShapes() {
      for (const geom of this.data.geoms) {
        const [r, g, b, opacity] = geom.colour;
        const material = new THREE.MeshStandardMaterial({
          color: new THREE.Color(r, g, b), roughness: 0.75, metalness: 0.05,
          flatShading: geom.shape === "mesh", transparent: opacity < 1, opacity,
        });
        for (const shape of shapes(geom)) {
          const mesh = new THREE.Mesh(shape, material);
          mesh.position.set(...geom.pos);
          mesh.quaternion.copy(quaternion(geom.quat));
          this.put("shapes", mesh, this.bodies[geom.body], geom.body);
        }
      }
    }

    addAxes() {
      const long = 0.28 * this.data.size;
      this.axes = this.data.joints.map((joint, index) => {
        const material = new THREE.MeshBasicMaterial({
          color: color("--joint"), transparent: true, opacity: 0.55, depthTest: false });
        const shape = new THREE.CylinderGeometry(0.006 * this.data.size, 0.006 * this.data.size, long);
        const mesh = new THREE.Mesh(shape, material);
        mesh.renderOrder = 2;
        mesh.position.set(...joint.anchor);
        const along = vector(joint.axis).normalize();
        mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along);
        this.put("axes", mesh, this.bodies[joint.body], index, "joint");
        return mesh;
      });
    }

    addMasses() {
      const total = this.data.bodies.reduce((sum, body) => sum + body.mass, 0) || 1;
      this.data.bodies.forEach((body, index) => {
        if (!body.mass) return;
        const radius = 0.09 * this.data.size * Math.cbrt(body.mass / total);
        const material = new THREE.MeshBasicMaterial({
          color: color("--ink"), transparent: true, opacity: 0.7, depthTest: false });
        const mesh = new THREE.Mesh(new THREE.SphereGeometry(radius, 16, 12), material);
        mesh.renderOrder = 3;
        mesh.position.set(...body.com);
        this.put("masses", mesh, this.bodies[index], index, "body");
      });
    }

    addForces() {
      const { contacts, size } = this.data;
      const weight = contacts.reduce((sum, one) => sum + vector(one.force).length(), 0);
      contacts.forEach((contact, index) => {
        const force = vector(contact.force);
        const long = 1.1 * size * force.length() / (weight || 1);
        if (!long) return;
        const head = 0.05 * size;
        const group = new THREE.Group();
        const material = new THREE.MeshBasicMaterial({ color: color("--force"), depthTest: false });
        const radius = 0.009 * size;
        const shaft = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, long), material);
        shaft.position.y = long / 2;
        const tip = new THREE.Mesh(new THREE.ConeGeometry(2.6 * radius, head), material);
        tip.position.y = long;
        group.position.set(...contact.point);
        group.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), force.clone().normalize());
        for (const part of [shaft, tip]) {
          part.renderOrder = 4;
          part.userData = { kind: "contact", index };
          this.targets.push(part);
          group.add(part);
        }
        this.put("forces", group);
      });
    }

    addSupport() {
      const { polygon, ground, normal, com, below, size } = this.data;
      const floor = new THREE.GridHelper(4 * size, 20, color("--line"), color("--line"));
      floor.position.set(ground[0], ground[1], ground[2] - 0.002 * size);
      floor.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), vector(normal).normalize());
      this.scene.add(floor);
      for (const { centre, half, quat, pit, round } of this.data.steps) {
        const [x, y, z] = half.map((side) => 2 * side);
        const shape = round ? new THREE.CylinderGeometry(half[0], half[0], z, 24).rotateX(Math.PI / 2)
          : new THREE.BoxGeometry(x, y, z);
        const box = new THREE.Mesh(shape, new THREE.MeshStandardMaterial({
          color: color("--line"), transparent: pit, opacity: pit ? 0.4 : 1 }));
        box.position.set(...centre);
        box.quaternion.copy(quaternion(quat));
        this.scene.add(box);
      }
      const ring = polygon.map(([x, y, z]) => new THREE.Vector3(x, y, z + 0.001 * size));
      if (ring.length > 1) {
        const line = new THREE.BufferGeometry().setFromPoints([...ring, ring[0]]);
        this.put("support", new THREE.Line(line, new THREE.LineBasicMaterial({ color: color("--support") })));
        const fan = new THREE.BufferGeometry().setFromPoints(ring);
        const faces = [];
        for (let index = 2; index < ring.length; index++) faces.push(0, index - 1, index);
        fan.setIndex(faces);
        this.put("support", new THREE.Mesh(fan, new THREE.MeshBasicMaterial({
          color: color("--support"), transparent: true, opacity: 0.25, side: THREE.DoubleSide })));
      }
      if (!com) return;
      const drop = new THREE.BufferGeometry().setFromPoints(
        [vector(com), vector(below)]);
      const dashed = new THREE.Line(drop, new THREE.LineBasicMaterial({ color: color("--com"), depthTest: false }));
      dashed.renderOrder = 4;
      this.put("support", dashed);
      const ball = new THREE.Mesh(new THREE.SphereGeometry(0.03 * size, 20, 14),
        new THREE.MeshBasicMaterial({ color: color("--com"), depthTest: false }));
      ball.renderOrder = 5;
      ball.position.set(...com);
      this.put("support", ball, null, 0, "com");
    }

    place() {
      const motion = this.data.motions[this.motion];
      const numbers = motion.numbers ?? (motion.numbers = new Int16Array(bytes(motion.frames)));
      this.bodies.forEach((body, index) => {
        const first = 7 * (this.frame * this.bodies.length + index);
        const [x, y, z, ...turn] = Array.from(numbers.subarray(first, first + 7), (n) => n / 32767);
        body.position.set(x, y, z).multiplyScalar(motion.reach);
        body.quaternion.copy(quaternion(turn)).normalize();
      });
      const at = this.stage.querySelector(".at");
      if (at) at.textContent = `${motion.time[this.frame].toFixed(2)} s`;
    }

    show(input) {
      const { layer } = input.dataset;
      const there = layer !== "forces" || this.motion === 0; // the forces belong to the stand, motion 0
      for (const object of this.layers[layer]) object.visible = input.checked && there;
    }

    resize() {
      if (!this.renderer) return;
      const { clientWidth: wide, clientHeight: tall } = this.box;
      this.renderer.setSize(wide, tall);
      this.camera.aspect = wide / tall;
      this.camera.updateProjectionMatrix();
      this.draw();
    }

    draw() {
      if (!this.renderer) return;
      const flat = Math.cos(this.elevation) * this.distance;
      // A narrow view needs more distance for the same width.
      const far = Math.max(1, 1.3 / this.camera.aspect);
      this.camera.position.set(
        this.target.x + far * flat * Math.cos(this.azimuth),
        this.target.y + far * flat * Math.sin(this.azimuth),
        this.target.z + far * this.distance * Math.sin(this.elevation));
      this.camera.lookAt(this.target);
      this.renderer.render(this.scene, this.camera);
    }

    turn(across, upward) {
      this.azimuth -= across;
      this.elevation = Math.max(-0.2, Math.min(1.55, this.elevation + upward));
      this.draw();
    }

    zoom(factor) {
      const { size } = this.data;
      this.distance = Math.max(0.5 * size, Math.min(20 * size, this.distance * factor));
      this.draw();
    }

    light(index, text) {
      this.lit = index;
      if (this.renderer)
        this.axes.forEach((mesh, number) => {
          mesh.material.color.copy(color(number === index ? "--lit" : "--joint"));
          mesh.material.opacity = number === index ? 1 : 0.55;
          mesh.scale.set(number === index ? 1.7 : 1, number === index ? 1.4 : 1,
            number === index ? 1.7 : 1);
        });
      for (const button of this.stage.querySelectorAll(".joint"))
        button.classList.toggle("lit", Number(button.dataset.joint) === index);
      if (text) this.hintLine.textContent = text; else this.hintLine.innerHTML = this.hint;
      this.draw();
    }

    tell(kind, index) {
      const words = said();
      const data = this.data;
      if (kind === "joint") {
        const joint = data.joints[index];
        const load = joint.slides ? "N" : "N m";
        const place = joint.slides ? `${(1e3 * joint.position).toFixed(1)} mm`
          : `${joint.position.toFixed(3)} rad`;
        const limit = joint.limit === null ? "" : ` / ${joint.limit} ${load}`;
        const torque = joint.torque === null ? "" :
          `; ${words.torque} ${joint.torque.toFixed(3)} ${load}${limit}`;
        return `${joint.name}: ${words[joint.motion] || joint.motion}; ${words.position} ` +
          `${place}${torque}`;
      }
      if (kind === "body") {
        const { name, mass } = data.bodies[index];
        return `${name}: ${words.mass} ${mass.toFixed(3)} kg`;
      }
      if (kind === "com")
        return `${words.com}: (${data.com.map((value) => value.toFixed(4)).join(", ")}) m`;
      const contact = data.contacts[index];
      return `${contact.name}: ${words.force} (${contact.force.map((value) => value.toFixed(2)).join(", ")}) N`;
    }

    point(event) {
      const bounds = this.renderer.domElement.getBoundingClientRect();
      const place = new THREE.Vector2(
        2 * (event.clientX - bounds.left) / bounds.width - 1,
        1 - 2 * (event.clientY - bounds.top) / bounds.height);
      const ray = new THREE.Raycaster();
      ray.setFromCamera(place, this.camera);
      const seen = (object) => object.visible && (!object.parent || seen(object.parent));
      const hit = ray.intersectObjects(this.targets.filter(seen), false)[0];
      const { kind, index } = hit ? hit.object.userData : {};
      const found = `${kind} ${index}`;
      if (found === this.found) return;
      this.found = found;
      this.light(kind === "joint" ? index : -1, hit ? this.tell(kind, index) : "");
    }

    listen() {
      const held = new Map();
      let apart = 0;
      const reach = () => {
        const [one, two] = [...held.values()];
        return Math.hypot(one.x - two.x, one.y - two.y);
      };
      this.box.addEventListener("pointerdown", (event) => {
        held.set(event.pointerId, { x: event.clientX, y: event.clientY });
        if (held.size === 2) apart = reach();
        this.box.setPointerCapture(event.pointerId);
      });
      const release = (event) => held.delete(event.pointerId);
      this.box.addEventListener("pointerup", release);
      this.box.addEventListener("pointercancel", release);
      this.box.addEventListener("pointermove", (event) => {
        if (!this.renderer) return;
        const before = held.get(event.pointerId);
        if (!before) { this.point(event); return; }
        held.set(event.pointerId, { x: event.clientX, y: event.clientY });
        if (held.size === 2) {
          const now = reach();
          this.zoom(apart / now);
          apart = now;
        } else {
          this.turn(0.01 * (event.clientX - before.x), 0.008 * (event.clientY - before.y));
        }
      });
      // The wheel alone scrolls the page; with Ctrl, as pads send it for a pinch, it zooms.
      this.box.addEventListener("wheel", (event) => {
        if (!event.ctrlKey) return;
        event.preventDefault();
        this.zoom(Math.exp(0.004 * event.deltaY));
      }, { passive: false });
      this.box.addEventListener("keydown", (event) => {
        const moves = {
          ArrowLeft: () => this.turn(-0.12, 0), ArrowRight: () => this.turn(0.12, 0),
          ArrowUp: () => this.turn(0, 0.1), ArrowDown: () => this.turn(0, -0.1),
          "+": () => this.zoom(0.85), "=": () => this.zoom(0.85), "-": () => this.zoom(1.18),
          0: () => this.reset(),
        };
        if (!moves[event.key] || event.ctrlKey || event.metaKey) return;
        event.preventDefault();
        moves[event.key]();
      });
      this.stage.querySelector(".reset").addEventListener("click", () => this.reset());
      for (const input of this.stage.querySelectorAll("[data-layer]"))
        input.addEventListener("change", () => { if (this.renderer) { this.show(input); this.draw(); } });
      for (const button of this.stage.querySelectorAll(".joint")) {
        const index = Number(button.dataset.joint);
        const on = () => this.light(index, this.tell("joint", index));
        const off = () => this.light(-1, "");
        button.addEventListener("pointerenter", on);
        button.addEventListener("focus", on);
        button.addEventListener("click", on);
        button.addEventListener("pointerleave", off);
        button.addEventListener("blur", off);
      }
      const slider = this.stage.querySelector(".time");
      const choice = this.stage.querySelector(".motion");
      const step = () => {
        this.frame = Number(slider.value);
        if (this.renderer) { this.place(); this.draw(); }
      };
      slider?.addEventListener("input", step);
      choice?.addEventListener("change", () => {
        this.motion = Number(choice.value);
        slider.max = this.data.motions[this.motion].time.length - 1;
        slider.value = 0;
        if (this.renderer)
          for (const input of this.stage.querySelectorAll("[data-layer]")) this.show(input);
        step();
      });
      window.report.listeners.push(() => {
        this.light(-1, "");
        if (this.renderer) { this.build(); this.draw(); } // in the colours of the other theme
      });
      new ResizeObserver(() => this.resize()).observe(this.box);
      new IntersectionObserver((entries) => {
        if (entries.some((entry) => entry.isIntersecting)) { this.start(); this.draw(); }
      }, { rootMargin: "200px" }).observe(this.box);
    }

    reset() {
      this.home();
      this.draw();
    }

    /** Append a picture of the view for printing: a view that was never visible has no canvas. */
    picture() {
      if (this.box.querySelector(".printed")) return; // a print preview may call this several times
      const there = Boolean(this.renderer);
      this.start();
      if (!this.renderer) return;
      this.resize();
      this.draw();
      const picture = new Image();
      picture.className = "printed";
      picture.alt = this.box.getAttribute("aria-label") ?? "";
      picture.src = this.renderer.domElement.toDataURL("image/png");
      this.box.append(picture);
      if (!there) this.stop();
    }
  }
  window.report.views = stages.map((stage) => new View(stage));
  addEventListener("beforeprint", () => { for (const view of window.report.views) view.picture(); });
  addEventListener("afterprint", () => {
    for (const picture of document.querySelectorAll(".canvas .printed")) picture.remove();
  });
})();
