// The 3D view: what `update` gets is drawn in between two updates too, so that motion is smooth.
import { makeMark, watchGround } from "jezero-ground-click";
import { CameraView, Ground, HAZE, makeBlob, makeDome, makeLights, makeRover, makeVehicle, Marks, Path, TO_SUN } from "jezero-models";
import { OrbitControls, THREE } from "nicegui-scene";

const LAG_S = 0.12; // time constant of the motion between two updates
const FRAME_GAP_MS = 33, FRAME_GAP_MAX_MS = 250;
const SLOW_MS = 100; // a frame that takes longer: fewer pixels, and no shadows
const SLOW_FRAMES = 4;
const PIXELS = [1, 0.8, 0.65]; // of the view for each of the screen, along a side; fewer step by step
const PIXELS_ENOUGH = 200_000; // a small view keeps all of its own
const ROVER_NEAR_M = 25, BESIDE_RAD = 0.35;
const ROTOR_RPS = 38;
const UP = new THREE.Vector3(0, 0, 1);

export default {
  template: `<div class="view3d"><canvas ref="canvas"></canvas>
    <div class="view3d-labels"><span v-for="label in labels" :key="label.name" :ref="'label-' + label.name" class="view3d-label">{{ label.text }}</span></div>
    <svg ref="north" class="view3d-north" viewBox="-50 -50 100 100" role="img" aria-label="north"><circle r="46" />
      <g><path d="M0 -42L11 -4H-11Z" class="needle" /><path d="M0 42L11 4H-11Z" /><text y="-20" class="letter">N</text></g></svg>
    <div class="view3d-foot"><span>{{ wind }}</span><span>{{ groundWords }}</span></div>
    <div class="view3d-note" v-if="note">{{ note }}</div></div>`,
  props: { robot: Object },
  data() {
    return { note: "", labels: [], wind: "", isTrue: false };
  },
  computed: {
    groundWords() {
      return `Grid 1 m, bold 10 m · ${this.isTrue ? "ground of the simulator" : "ground unknown: drawn level"}`;
    },
  },
  mounted() {
    const slow = drawsWithoutCard();
    this.fewer = slow ? 1 : 0;
    try {
      this.renderer = new THREE.WebGLRenderer({ canvas: this.$refs.canvas, antialias: !slow });
    } catch (error) {
      this.note = "This browser has no WebGL: the 3D view is not drawn; the map is.";
      return;
    }
    this.build(slow);
    this.sun.castShadow = !slow;
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    watchGround(this.renderer.domElement, this.camera, this.ground.group, (point) => this.$emit("point", point));
    Object.assign(this.controls, { maxPolarAngle: 0.495 * Math.PI, minDistance: 0.6, maxDistance: 250, enableDamping: true });
    this.ready = true;
    this.sizes = new ResizeObserver(() => this.resize());
    this.sizes.observe(this.$el);
    this.resize();
    this.lastDraw = this.cost = this.frames = 0;
    this.draw = this.draw.bind(this);
    requestAnimationFrame(this.draw);
    this.$emit("ready");
  },
  unmounted() {
    this.gone = true;
    this.sizes?.disconnect();
    this.renderer?.dispose();
  },
  methods: {
    build(slow) {
      this.scene = new THREE.Scene();
      this.scene.fog = new THREE.Fog(HAZE, 35, 260);
      this.ned = new THREE.Group(); // its children have ned coordinates; the scene is east, north, up
      this.ned.quaternion.set(Math.SQRT1_2, Math.SQRT1_2, 0, 0);
      this.dome = makeDome();
      this.scene.add(this.ned, this.dome);
      this.sun = makeLights(this.scene);
      this.camera = new THREE.PerspectiveCamera(50, 1, 0.05, 2500);
      this.camera.up.copy(UP);
      this.camera.position.set(-5, -6, 4);
      this.renderer.shadowMap.enabled = true;
      this.renderer.toneMapping = THREE.ACESFilmicToneMapping;
      this.vehicle = makeVehicle(this.robot);
      this.rover = makeRover(this.robot);
      this.vehicle.visible = this.rover.visible = false;
      this.ground = new Ground(slow);
      this.marks = new Marks(this.ground);
      this.marks.setHome([0, 0]);
      this.blob = makeBlob(1.1);
      this.roverBlob = makeBlob(1.9 * this.robot.platform.side);
      this.trail = new Path({ color: 0x3aa0ff, width: 0.05, curtain: 0.13 });
      this.tail = new Path({ color: 0x3aa0ff, width: 0.05 }); // from the trail's end to the vehicle
      this.plan = new Path({ color: 0xffd84d, width: 0.06, dashed: true });
      this.view = new CameraView(this.robot.camera, this.ground);
      const parts = [this.ground, this.marks, this.trail, this.tail, this.plan, this.view].map((part) => part.group);
      this.ned.add(...parts, this.blob, this.roverBlob, this.vehicle, this.rover);
      this.mark = makeMark();
      this.ned.add(this.mark);
      this.mode = "follow";
    },
    // -- data --
    update(data) {
      if (!this.ready) return;
      if (!this.state?.vehicle && data.vehicle) this.snap = true;
      this.state = data;
      this.vehicle.visible = !!data.vehicle;
      this.rover.visible = !!data.rover;
      this.followGround(data);
      this.wind = `Wind ${data.wind_words}`;
      this.labels = this.labelsOf(data);
    },
    followGround({ vehicle, rover, range }) {
      if (!vehicle || vehicle.late) return;
      const overRover = rover && Math.hypot(vehicle.pos[0] - rover.pos[0], vehicle.pos[1] - rover.pos[1]) < 1.5 * this.robot.platform.side;
      if (overRover || (range === null && !vehicle.landed)) return;
      const [, x, y] = vehicle.q, upright = 1 - 2 * (x * x + y * y);
      this.ground.follow(vehicle.pos, vehicle.landed ? 0 : range * upright - this.robot.altimeter);
      this.marks.setHome([0, 0]);
    },
    labelsOf({ rover, ellipsoid, lost }) {
      const labels = [];
      if (rover) {
        const widest = ellipsoid ? Math.max(...ellipsoid.map((axis) => Math.hypot(...axis))) : null;
        labels.push({ name: "rover", text: widest === null ? "rover" : `rover ±${widest.toFixed(2)} m (3σ)`, at: rover.pos, lift: -0.75 });
      }
      if (lost) labels.push({ name: "lost", text: `last seen here ${lost.age}`, at: lost.pos, lift: 0.45 });
      return labels;
    },
    setGround(shape) {
      if (!this.ready) return;
      this.ground.set(shape);
      this.isTrue = this.ground.isTrue;
      this.marks.setHome([0, 0]);
    },
    setTrail(points) {
      if (!this.ready) return;
      this.trail.set(points, (north, east) => this.ground.heightAt(north, east));
      this.end = points.at(-1);
    },
    setPlan(points) {
      if (this.ready) this.plan.set(points);
    },
    setPhotos(points) {
      if (this.ready) this.marks.setPhotos(points);
    },
    // The point that a form has, [north, east, down], or null.
    setPoint(point) {
      if (this.ready) this.mark.show(point, point ? this.ground.heightAt(point[0], point[1]) : 0);
    },
    setMode(mode) {
      if (!this.ready) return;
      this.mode = mode;
      this.snap = true;
    },
    // -- frames --
    resize() {
      const { clientWidth: width, clientHeight: height } = this.$el;
      if (!width || !height) return;
      const enough = Math.sqrt(PIXELS_ENOUGH / (width * height));
      this.renderer.setPixelRatio(Math.max(PIXELS[this.fewer], Math.min(enough, 1)) * Math.min(window.devicePixelRatio, 2));
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.fov = width > height ? 50 : 62;
      this.camera.updateProjectionMatrix();
    },
    draw(now) {
      if (this.gone) return;
      requestAnimationFrame(this.draw);
      // A machine without a graphics card needs most of its time for other things than this picture.
      const gap = Math.min(Math.max(FRAME_GAP_MS, 1.5 * this.cost), FRAME_GAP_MAX_MS);
      if (now - this.lastDraw < gap || !this.$el.clientWidth || document.hidden) return;
      const dt = Math.min((now - this.lastDraw) / 1000, 0.5);
      this.lastDraw = now;
      this.move(dt);
      const start = performance.now();
      this.renderer.render(this.scene, this.camera);
      this.placeLabels();
      if (this.frames++ % 10 === 0 || this.cost > SLOW_MS) this.measure(start);
    },
    // The graphics process works on its own; reading a pixel waits until it has drawn.
    measure(start) {
      const gl = this.renderer.getContext();
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
      this.cost = performance.now() - start;
      this.slowFrames = this.cost > SLOW_MS ? (this.slowFrames ?? 0) + 1 : 0;
      if (this.slowFrames < SLOW_FRAMES || this.fewer === PIXELS.length - 1) return;
      this.slowFrames = 0;
      this.fewer += 1;
      this.sun.castShadow = false;
      this.resize();
    },
    move(dt) {
      const share = this.snap ? 1 : 1 - Math.exp(-dt / LAG_S);
      const { vehicle, rover } = this.state ?? {};
      if (vehicle) this.moveVehicle(vehicle, share, dt);
      if (rover) {
        this.rover.position.lerp(new THREE.Vector3(...rover.pos), share);
        this.rover.quaternion.slerp(new THREE.Quaternion().setFromAxisAngle(UP, rover.yaw), share);
      }
      const at = vehicle ? this.vehicle.position : null;
      const isHigh = at && vehicle.armed && -at.z - this.ground.heightAt(at.x, at.y) > 0.5;
      this.view.group.visible = !!at && !vehicle.late;
      this.marks.setDrop(isHigh ? at : null);
      this.marks.setWind(vehicle?.armed ? this.state.wind : null, at);
      this.marks.setEllipsoid(this.state?.ellipsoid, rover ? this.rover.position : at);
      this.marks.setLost(this.state?.lost);
      this.moveCamera();
      this.snap = false;
    },
    moveVehicle(vehicle, share, dt) {
      const [w, x, y, z] = vehicle.q;
      const center = new THREE.Vector3(vehicle.pos[0], vehicle.pos[1], vehicle.pos[2] - this.robot.stand);
      this.vehicle.position.lerp(center, share);
      this.vehicle.quaternion.slerp(new THREE.Quaternion(x, y, z, w), share);
      for (const rotor of this.vehicle.rotors) {
        rotor.rotation.z += rotor.spin * (vehicle.armed && !vehicle.late ? ROTOR_RPS : 0) * dt;
        rotor.disc.visible = vehicle.armed;
      }
      const flown = vehicle.armed && this.end ? [this.end] : [];
      this.tail.set([...flown, [this.vehicle.position.x, this.vehicle.position.y, this.vehicle.position.z + this.robot.stand]]);
      this.view.update(this.vehicle.position, this.vehicle.quaternion, this.state.camera);
    },
    moveCamera() {
      const subject = this.vehicle.visible ? this.vehicle : this.rover;
      const at = subject.getWorldPosition(new THREE.Vector3());
      this.moveLight(at);
      const step = this.lastAt ? at.clone().sub(this.lastAt) : new THREE.Vector3();
      this.lastAt = at;
      if (this.snap && this.mode === "follow") {
        this.camera.position.copy(at).add(this.besideVehicle(at));
        this.controls.target.copy(at);
      } else if (this.snap && this.mode === "top") {
        this.camera.position.set(at.x, at.y - 0.01, at.z + 18);
        this.controls.target.copy(at);
      } else if (this.mode !== "free") {
        this.camera.position.add(step);
        this.controls.target.add(step);
      }
      this.controls.update();
      const floor = this.ground.heightAt(this.camera.position.y, this.camera.position.x) + 0.25;
      if (this.camera.position.z < floor) this.camera.position.z = floor;
      this.dome.position.copy(this.camera.position);
      const turn = Math.atan2(this.controls.target.x - this.camera.position.x, this.controls.target.y - this.camera.position.y);
      this.$refs.north.style.transform = `rotate(${-turn}rad)`;
    },
    // Where the eye is beside the vehicle: so that the rover, if it is near, is behind the vehicle and beside it.
    besideVehicle(at) {
      const rover = this.rover.visible ? this.rover.getWorldPosition(new THREE.Vector3()) : at;
      const away = new THREE.Vector3(at.x - rover.x, at.y - rover.y, 0), distance = away.length();
      if (distance < 1 || distance > ROVER_NEAR_M) away.set(-0.62, -0.79, 0);
      else away.normalize().applyAxisAngle(UP, BESIDE_RAD);
      return away.multiplyScalar(4.7).setZ(1.7);
    },
    // The sun moves along with the vehicle, so that the finest part of its shadows is there.
    moveLight(at) {
      this.sun.target.position.copy(at);
      this.sun.position.copy(at).addScaledVector(TO_SUN, 40);
      this.placeBlob(this.blob, this.vehicle);
      this.placeBlob(this.roverBlob, this.rover);
    },
    placeBlob(blob, object) {
      blob.visible = !this.sun.castShadow && object.visible;
      const { x: north, y: east, z: down } = object.position, away = (-down - this.ground.heightAt(north, east)) / TO_SUN.z;
      const [n, e] = [north - away * TO_SUN.y, east - away * TO_SUN.x];
      blob.position.set(n, e, -this.ground.heightAt(n, e) - 0.02);
    },
    placeLabels() {
      const { clientWidth: width, clientHeight: height } = this.$el;
      for (const { name, at, lift } of this.labels) {
        const element = this.$refs[`label-${name}`]?.[0];
        if (!element) continue;
        const place = new THREE.Vector3(at[1], at[0], lift - at[2]).project(this.camera);
        const shown = place.z < 1 && Math.abs(place.x) < 1 && Math.abs(place.y) < 1;
        element.style.visibility = shown ? "visible" : "hidden";
        element.style.transform = `translate(${0.5 * (1 + place.x) * width}px, ${0.5 * (1 - place.y) * height}px) translate(-50%, ${lift > 0 ? -100 : 0}%)`;
      }
    },
  },
};

// Whether the browser draws with the processor alone.
function drawsWithoutCard() {
  const gl = document.createElement("canvas").getContext("webgl2"), info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}
