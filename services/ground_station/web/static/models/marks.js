// What is drawn into the scene to be read: uncertainty, wind, home, and the place where the vehicle was last.
import { THREE } from "nicegui-scene";

const WIND_M_PER_MPS = 0.16, WIND_MAX_M = 2.2, WIND_MIN_MPS = 0.1;
const LIFT_M = 0.03;

export class Marks {
  constructor(ground) {
    this.ground = ground;
    this.group = new THREE.Group();
    this.ellipsoid = makeEllipsoid();
    this.wind = makeArrow();
    this.home = makeHome();
    this.lost = makePin();
    this.drop = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: 0xffffff, transparent: true, opacity: 0.8, fog: false }));
    this.photos = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ color: 0xffffff, size: 0.1, fog: false }));
    this.drop.frustumCulled = this.photos.frustumCulled = false;
    this.group.add(this.ellipsoid, this.wind, this.home, this.lost, this.drop, this.photos);
    this.ellipsoid.visible = this.wind.visible = this.lost.visible = this.drop.visible = false;
  }
  // `axes`: three half axes in ned; null hides it.
  setEllipsoid(axes, at) {
    this.ellipsoid.visible = !!axes && !!at;
    if (!this.ellipsoid.visible) return;
    const [a, b, c] = axes.map((axis) => {
      const vector = new THREE.Vector3(...axis);
      return vector.lengthSq() > 1e-8 ? vector : vector.set(1e-4, 1e-4, 1e-4);
    });
    this.ellipsoid.matrix.makeBasis(a, b, c).setPosition(at);
  }
  // The arrow points where the air moves to, beside the vehicle.
  setWind(wind, at) {
    const speed = wind ? Math.hypot(wind[0], wind[1]) : 0;
    this.wind.visible = speed > WIND_MIN_MPS && !!at;
    if (!this.wind.visible) return;
    this.wind.position.set(at.x, at.y, at.z - 0.55);
    this.wind.rotation.z = Math.atan2(wind[1], wind[0]);
    this.wind.scale.setScalar(Math.min(Math.max(speed * WIND_M_PER_MPS, 0.35), WIND_MAX_M));
  }
  setHome([north, east]) {
    this.home.position.set(north, east, -this.ground.heightAt(north, east) - LIFT_M);
  }
  setLost(lost) {
    this.lost.visible = !!lost;
    if (!lost) return;
    const [north, east, down] = lost.pos, ground = -this.ground.heightAt(north, east);
    this.lost.position.set(north, east, ground);
    this.lost.pole.scale.z = Math.min(down - ground, -0.05) - 0.8;
    this.lost.cross.position.z = this.lost.pole.scale.z;
  }
  // Where images were taken.
  setPhotos(points) {
    this.photos.geometry.dispose();
    this.photos.geometry = new THREE.BufferGeometry();
    this.photos.geometry.setAttribute("position", new THREE.Float32BufferAttribute(points.flat(), 3));
  }
  setDrop(at) {
    this.drop.visible = !!at;
    if (!at) return;
    const below = new THREE.Vector3(at.x, at.y, -this.ground.heightAt(at.x, at.y) - LIFT_M);
    const [n, e] = [new THREE.Vector3(0.12, 0, 0), new THREE.Vector3(0, 0.12, 0)];
    const ends = [at, below, below.clone().sub(n), below.clone().add(n), below.clone().sub(e), below.clone().add(e)];
    this.drop.geometry.setFromPoints(ends);
  }
}

// A unit ball whose matrix makes an ellipsoid of it; seen through the platform in which it mostly is.
function makeEllipsoid() {
  const group = new THREE.Group();
  const look = { color: 0x35e0ff, transparent: true, depthTest: false, depthWrite: false, fog: false };
  group.add(new THREE.Mesh(new THREE.SphereGeometry(1, 24, 16), new THREE.MeshBasicMaterial({ ...look, opacity: 0.28 })));
  const circle = Array.from({ length: 48 }, (_, i) => [Math.cos((i * Math.PI) / 24), Math.sin((i * Math.PI) / 24)]);
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(circle.flatMap(([a, b]) => [0, a, b]), 3)); // the two longest axes
  group.add(new THREE.LineLoop(geometry, new THREE.LineBasicMaterial({ ...look, opacity: 1 })));
  group.matrixAutoUpdate = false;
  for (const part of group.children) part.renderOrder = 5;
  return group;
}

// An arrow of length 1 to the north.
function makeArrow() {
  const group = new THREE.Group(), material = new THREE.MeshBasicMaterial({ color: 0xffffff, transparent: true, opacity: 0.9, fog: false });
  const shaft = new THREE.Mesh(new THREE.CylinderGeometry(0.035, 0.035, 0.7, 8), material);
  const head = new THREE.Mesh(new THREE.ConeGeometry(0.12, 0.3, 12), material);
  shaft.position.y = -0.15;
  head.position.y = 0.35;
  const turned = new THREE.Group();
  turned.add(shaft, head);
  turned.rotation.z = -Math.PI / 2; // from its own y to the north
  group.add(turned);
  return group;
}

// A ring with an H, its top to the north.
function makeHome() {
  const image = document.createElement("canvas");
  image.width = image.height = 256;
  const c = image.getContext("2d");
  c.strokeStyle = c.fillStyle = "rgba(255,255,255,.9)";
  c.lineWidth = 14;
  c.beginPath();
  c.arc(128, 142, 98, 0, 7);
  c.stroke();
  c.font = "700 120px system-ui, sans-serif";
  c.textAlign = "center";
  c.textBaseline = "middle";
  c.fillText("H", 128, 148);
  c.beginPath();
  c.moveTo(128, 0);
  c.lineTo(158, 36);
  c.lineTo(98, 36);
  c.fill();
  const map = new THREE.CanvasTexture(image);
  map.colorSpace = THREE.SRGBColorSpace;
  const home = new THREE.Mesh(
    new THREE.PlaneGeometry(1.3, 1.3),
    new THREE.MeshBasicMaterial({ map, transparent: true, depthWrite: false, polygonOffset: true, polygonOffsetFactor: -2 }),
  );
  home.rotation.set(Math.PI, 0, Math.PI / 2);
  return home;
}

// A pole on the ground with a cross at its top, in ned.
function makePin() {
  const pin = new THREE.Group(), material = new THREE.MeshBasicMaterial({ color: 0xffffff, fog: false });
  pin.pole = new THREE.Mesh(new THREE.BoxGeometry(0.02, 0.02, 1).translate(0, 0, 0.5), material);
  pin.cross = new THREE.Group();
  for (const angle of [1, -1]) {
    const bar = new THREE.Mesh(new THREE.BoxGeometry(0.4, 0.03, 0.03), material);
    bar.rotation.z = (angle * Math.PI) / 4;
    pin.cross.add(bar);
  }
  pin.add(pin.pole, pin.cross);
  return pin;
}
