// The 3D view: what `update` gets is drawn in between two updates too, so that motion is smooth.
import { makeGround, makeRover, makeVehicle } from "jezero-models";
import { OrbitControls, THREE } from "nicegui-scene";

const LAG_S = 0.12; // time constant of the motion between two updates
const FRAME_GAP_MS = 33;
const SLOW_MS = 80; // a frame that takes longer: no graphics card, so no shadows and fewer pixels
const SKY = 0xd9b48f;

export default {
  template: '<div class="view3d"><canvas ref="canvas"></canvas><div class="view3d-note" v-if="note">{{ note }}</div></div>',
  props: { robot: Object },
  data() {
    return { note: "" };
  },
  mounted() {
    try {
      this.renderer = new THREE.WebGLRenderer({ canvas: this.$refs.canvas, antialias: true });
    } catch (error) {
      this.note = "This browser has no WebGL: the 3D view is not drawn; the map is.";
      return;
    }
    this.build();
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.maxPolarAngle = 0.495 * Math.PI;
    this.controls.enableDamping = true;
    this.ready = true;
    this.sizes = new ResizeObserver(() => this.resize());
    this.sizes.observe(this.$el);
    this.resize();
    this.lastDraw = this.cost = this.frames = 0;
    this.draw = this.draw.bind(this);
    requestAnimationFrame(this.draw);
  },
  unmounted() {
    this.gone = true;
    this.sizes?.disconnect();
    this.renderer?.dispose();
  },
  methods: {
    build() {
      this.scene = new THREE.Scene();
      this.scene.background = new THREE.Color(SKY);
      this.scene.fog = new THREE.Fog(SKY, 60, 220);
      this.ned = new THREE.Group(); // its children have ned coordinates; the scene is east, north, up
      this.ned.quaternion.set(Math.SQRT1_2, Math.SQRT1_2, 0, 0);
      this.scene.add(this.ned, new THREE.HemisphereLight(0xffe9d2, 0x6b3a24, 1.1));
      this.sun = new THREE.DirectionalLight(0xfff1dd, 2.6);
      this.sun.castShadow = true;
      this.sun.shadow.mapSize.set(1024, 1024);
      Object.assign(this.sun.shadow.camera, { left: -14, right: 14, top: 14, bottom: -14, near: 1, far: 90 });
      this.sun.shadow.bias = -0.001;
      this.scene.add(this.sun, this.sun.target);
      this.camera = new THREE.PerspectiveCamera(50, 1, 0.05, 600);
      this.camera.up.set(0, 0, 1);
      this.camera.position.set(-5, -6, 4);
      this.renderer.shadowMap.enabled = true;
      this.renderer.toneMapping = THREE.ACESFilmicToneMapping;
      this.vehicle = makeVehicle(this.robot);
      this.rover = makeRover(this.robot);
      this.vehicle.visible = this.rover.visible = false;
      this.ground = makeGround();
      this.trail = this.line(0x2f9bff, 2, false);
      this.plan = this.line(0xffd34d, 2, true);
      this.frustum = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: 0xffffff, transparent: true, opacity: 0.55 }));
      this.drop = this.line(0xffffff, 1, true);
      this.ellipse = new THREE.Mesh(
        new THREE.SphereGeometry(1, 24, 12), new THREE.MeshBasicMaterial({ color: 0x4dd2ff, wireframe: true, transparent: true, opacity: 0.18 }),
      );
      this.ellipse.visible = false;
      this.ned.add(this.ground, this.vehicle, this.rover, this.trail, this.plan, this.frustum, this.drop, this.ellipse);
      this.mode = "follow";
      this.target = null;
    },
    line(color, linewidth, dashed) {
      const material = dashed
        ? new THREE.LineDashedMaterial({ color, linewidth, dashSize: 0.3, gapSize: 0.18 })
        : new THREE.LineBasicMaterial({ color, linewidth });
      const line = new THREE.Line(new THREE.BufferGeometry(), material);
      line.frustumCulled = false;
      return line;
    },
    setPoints(line, points) {
      line.geometry.dispose();
      line.geometry = new THREE.BufferGeometry();
      line.geometry.setAttribute("position", new THREE.Float32BufferAttribute(points.flat(), 3));
      if (line.material.isLineDashedMaterial && points.length > 1) line.computeLineDistances();
    },
    update(data) {
      if (!this.ready) return;
      const first = !this.state?.vehicle && data.vehicle;
      this.state = data;
      this.vehicle.visible = !!data.vehicle;
      this.rover.visible = !!data.rover;
      if (first) this.snap = true;
    },
    setTrail(points) {
      if (this.ready) this.setPoints(this.trail, points);
    },
    setPlan(points) {
      if (this.ready) this.setPoints(this.plan, points);
    },
    setMode(mode) {
      if (!this.ready) return;
      this.mode = mode;
      this.snap = true;
    },
    resize() {
      const { clientWidth: width, clientHeight: height } = this.$el;
      if (!width || !height) return;
      this.renderer.setPixelRatio(this.sun.castShadow ? Math.min(window.devicePixelRatio, 2) : 0.7);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
    },
    draw(now) {
      if (this.gone) return;
      requestAnimationFrame(this.draw);
      // A machine without a graphics card gets a third of its time at most.
      if (now - this.lastDraw < Math.max(FRAME_GAP_MS, 3 * this.cost) || !this.$el.clientWidth || document.hidden) return;
      const dt = Math.min((now - this.lastDraw) / 1000, 0.5);
      this.lastDraw = now;
      this.move(dt);
      const start = performance.now();
      this.renderer.render(this.scene, this.camera);
      if (this.frames++ % 10 === 0) this.measure(start);
    },
    // The graphics process works on its own; reading a pixel waits until it has drawn.
    measure(start) {
      const gl = this.renderer.getContext();
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
      this.cost = performance.now() - start;
      if (this.cost > SLOW_MS && this.sun.castShadow) {
        this.sun.castShadow = false;
        this.resize();
      }
    },
    move(dt) {
      const share = this.snap ? 1 : 1 - Math.exp(-dt / LAG_S);
      const { vehicle, rover } = this.state ?? {};
      if (vehicle) {
        const [w, x, y, z] = vehicle.q;
        const center = new THREE.Vector3(vehicle.pos[0], vehicle.pos[1], vehicle.pos[2] - this.robot.stand);
        this.vehicle.position.lerp(center, share);
        this.vehicle.quaternion.slerp(new THREE.Quaternion(x, y, z, w), share);
        for (const rotor of this.vehicle.rotors) {
          rotor.rotation.z += rotor.spin * (vehicle.armed ? 38 : 0) * dt;
          rotor.disc.visible = vehicle.armed;
        }
        this.drawFrustum();
        this.drawEllipse();
      }
      if (rover) {
        this.rover.position.lerp(new THREE.Vector3(...rover.pos), share);
        this.rover.quaternion.slerp(new THREE.Quaternion().setFromAxisAngle(new THREE.Vector3(0, 0, 1), rover.yaw), share);
      }
      this.frustum.visible = this.drop.visible = this.vehicle.visible;
      this.moveCamera();
      this.snap = false;
    },
    // Corners of the camera's view on the level ground, and lines to them.
    drawFrustum() {
      const optics = this.robot.camera, angles = this.state.camera;
      const at = new THREE.Vector3(...optics.pos).applyQuaternion(this.vehicle.quaternion).add(this.vehicle.position);
      const pitch = new THREE.Quaternion().setFromAxisAngle(new THREE.Vector3(0, 1, 0), angles.pitch);
      const roll = new THREE.Quaternion().setFromAxisAngle(new THREE.Vector3(1, 0, 0), angles.roll);
      const points = [];
      for (const [right, down] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
        const ray = new THREE.Vector3(1, right * optics.tan_right, down * optics.tan_down);
        ray.applyQuaternion(pitch).applyQuaternion(roll).applyQuaternion(this.vehicle.quaternion);
        const range = ray.z > 0.05 ? Math.min(-at.z / ray.z, 40) : 40 / ray.length();
        points.push(at.clone().addScaledVector(ray, Math.max(range, 0)));
      }
      const ends = [];
      points.forEach((point, i) => ends.push(at, point, point, points[(i + 1) % 4]));
      this.frustum.geometry.setFromPoints(ends);
      const below = new THREE.Vector3(at.x, at.y, 0);
      this.drop.geometry.setFromPoints([this.vehicle.position, below]);
      this.drop.computeLineDistances();
    },
    // Three standard deviations of the position relative to the rover.
    drawEllipse() {
      const cov = this.state.rover?.cov;
      this.ellipse.visible = !!cov && this.state.vehicle.armed;
      if (!cov) return;
      this.ellipse.position.copy(this.vehicle.position);
      this.ellipse.scale.set(...[0, 1, 2].map((axis) => 3 * Math.sqrt(Math.max(cov[axis], 1e-6))));
    },
    moveCamera() {
      const subject = this.vehicle.visible ? this.vehicle : this.rover;
      const at = new THREE.Vector3();
      subject.getWorldPosition(at);
      this.sun.target.position.copy(at);
      this.sun.position.set(at.x + 14, at.y - 20, at.z + 34);
      const step = this.lastAt ? at.clone().sub(this.lastAt) : new THREE.Vector3();
      this.lastAt = at.clone();
      if (this.snap && this.mode === "follow") {
        this.camera.position.set(at.x - 3.4, at.y - 4.4, at.z + 2.2);
        this.controls.target.copy(at);
      } else if (this.snap && this.mode === "top") {
        this.camera.position.set(at.x, at.y - 0.01, at.z + 18);
        this.controls.target.copy(at);
      } else if (this.mode !== "free") {
        this.camera.position.add(step);
        this.controls.target.add(step);
      }
      this.controls.update();
      if (this.camera.position.z < 0.15) this.camera.position.z = 0.15;
    },
  },
};
