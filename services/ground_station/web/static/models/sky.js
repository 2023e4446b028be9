// Sky, haze and light of a Martian day (fog is not tone mapped, so the sky isn't), in east, north, up. The sun stands where the simulator's camera has it.
import { THREE } from "nicegui-scene";

export const HAZE = 0xd9ae86;
const ZENITH = 0x8f7461, MIDDLE = 0xc39672;
const SUN_AZIMUTH = (310 / 180) * Math.PI, SUN_ELEVATION = (48 / 180) * Math.PI;
const DOME_M = 900;
export const TO_SUN = new THREE.Vector3(
  Math.cos(SUN_ELEVATION) * Math.sin(SUN_AZIMUTH), Math.cos(SUN_ELEVATION) * Math.cos(SUN_AZIMUTH), Math.sin(SUN_ELEVATION),
);

export function makeDome() {
  const geometry = new THREE.SphereGeometry(DOME_M, 24, 24), { position } = geometry.attributes;
  const colours = new Float32Array(3 * position.count), colour = new THREE.Color();
  const [haze, middle, zenith] = [HAZE, MIDDLE, ZENITH].map((hex) => new THREE.Color(hex));
  for (let i = 0; i < position.count; i++) {
    const up = Math.max(position.getY(i) / DOME_M, 0) ** 0.7; // the sphere's own axis is y
    if (up < 0.35) colour.lerpColors(haze, middle, up / 0.35);
    else colour.lerpColors(middle, zenith, (up - 0.35) / 0.65);
    colour.toArray(colours, 3 * i);
  }
  geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
  geometry.rotateX(Math.PI / 2);
  const dome = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ vertexColors: true, side: THREE.BackSide, fog: false, toneMapped: false, depthWrite: false }));
  dome.renderOrder = 1; // behind everything else, and so only where nothing else is
  dome.add(makeSun());
  return dome;
}

// On Mars the dust makes the sky around the sun blue-white.
function makeSun() {
  const material = new THREE.SpriteMaterial({
    map: glow([[0, "rgba(255,255,255,1)"], [0.07, "rgba(245,250,255,1)"], [0.12, "rgba(205,225,245,.55)"], [1, "rgba(205,225,245,0)"]]),
    blending: THREE.AdditiveBlending, fog: false, toneMapped: false, depthWrite: false,
  });
  const sun = new THREE.Sprite(material);
  sun.position.copy(TO_SUN).multiplyScalar(0.95 * DOME_M);
  sun.scale.setScalar(0.5 * DOME_M);
  return sun;
}

const SUN = [0xfff0dc, 2.7], SKY = [0xf3d3b0, 0x7a4a30, 1.25];

// What a matt surface with an upward normal in ned reflects of these lights: a factor for each colour.
export function lightOn(north, east, down) {
  const [sun, sky, soil] = [SUN[0], SKY[0], SKY[1]].map((hex) => new THREE.Color(hex));
  const direct = SUN[1] * Math.max(east * TO_SUN.x + north * TO_SUN.y - down * TO_SUN.z, 0);
  const around = soil.lerp(sky, 0.5 - 0.5 * down).multiplyScalar(SKY[2]);
  return sun.multiplyScalar(direct).add(around).multiplyScalar(1 / Math.PI).toArray();
}

export function makeLights(scene) {
  const sun = new THREE.DirectionalLight(...SUN);
  sun.castShadow = true;
  sun.shadow.mapSize.set(1024, 1024);
  Object.assign(sun.shadow.camera, { left: -12, right: 12, top: 12, bottom: -12, near: 1, far: 90 });
  sun.shadow.bias = -0.001;
  scene.add(new THREE.HemisphereLight(...SKY), sun, sun.target);
  return sun;
}

// A soft shadow, where real shadows would take too long.
export function makeBlob(size) {
  const map = glow([[0, "rgba(20,8,2,.62)"], [0.35, "rgba(20,8,2,.5)"], [1, "rgba(20,8,2,0)"]]);
  const blob = new THREE.Mesh(
    new THREE.PlaneGeometry(size, size),
    new THREE.MeshBasicMaterial({ map, transparent: true, depthWrite: false, polygonOffset: true, polygonOffsetFactor: -4 }),
  );
  blob.rotation.x = Math.PI; // its face up, in ned
  return blob;
}

function glow(stops) {
  const image = document.createElement("canvas");
  image.width = image.height = 128;
  const c = image.getContext("2d"), fill = c.createRadialGradient(64, 64, 0, 64, 64, 64);
  for (const [at, colour] of stops) fill.addColorStop(at, colour);
  c.fillStyle = fill;
  c.fillRect(0, 0, 128, 128);
  const texture = new THREE.CanvasTexture(image);
  texture.colorSpace = THREE.SRGBColorSpace;
  return texture;
}
