// Meshes of vehicle and rover. All are in jezero's own axes: frd (forward, right, down) and ned.
import { THREE } from "nicegui-scene";

export { Ground } from "./ground.js";
export { Marks } from "./marks.js";
export { CameraView } from "./optics.js";
export { Path } from "./paths.js";
export { HAZE, makeBlob, makeDome, makeLights, TO_SUN } from "./sky.js";

const BODY = 0x2b3440, BLADE = 0x11161c, NOSE = 0xff8a1f;

function box(size, position, color, parent) {
  const mesh = new THREE.Mesh(new THREE.BoxGeometry(...size), new THREE.MeshStandardMaterial({ color, roughness: 0.6 }));
  mesh.position.set(...position);
  mesh.castShadow = mesh.receiveShadow = true;
  parent.add(mesh);
  return mesh;
}

// A cylinder between two points.
function rod(from, to, radius, color, parent) {
  const a = new THREE.Vector3(...from), b = new THREE.Vector3(...to), axis = b.clone().sub(a);
  const geometry = new THREE.CylinderGeometry(radius, radius, axis.length(), 8);
  const mesh = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ color, roughness: 0.5 }));
  mesh.position.copy(a).addScaledVector(axis, 0.5);
  mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), axis.normalize());
  mesh.castShadow = true;
  parent.add(mesh);
  return mesh;
}

// The vehicle in frd. `rotors` of the returned group are turned by the caller.
export function makeVehicle(robot) {
  const group = new THREE.Group();
  box([0.26, 0.14, 0.08], [0, 0, 0], BODY, group);
  box([0.14, 0.09, 0.05], [-0.02, 0, -0.06], 0xe8edf2, group);
  box([0.05, 0.1, 0.06], [0.14, 0, -0.005], NOSE, group);
  const [footForward, footRight] = robot.feet;
  for (const f of [1, -1]) {
    for (const r of [1, -1]) {
      rod([0.5 * f * footForward, 0.5 * r * footRight, 0], [f * footForward, r * footRight, robot.stand], 0.009, 0x8794a3, group);
    }
  }
  group.rotors = [];
  for (const [forward, right] of robot.rotors) {
    rod([0, 0, -0.01], [forward, right, -0.03], 0.013, 0x536173, group);
    rod([forward, right, -0.02], [forward, right, -0.06], 0.022, forward > 0 ? NOSE : BODY, group);
    const rotor = new THREE.Group();
    rotor.position.set(forward, right, -0.065);
    rotor.spin = forward * right > 0 ? -1 : 1;
    const blade = box([2 * robot.radius, 0.025, 0.006], [0, 0, 0], BLADE, rotor);
    blade.receiveShadow = false;
    const disc = new THREE.Mesh(
      new THREE.CircleGeometry(robot.radius, 32),
      new THREE.MeshBasicMaterial({ color: 0xcfe3ff, transparent: true, opacity: 0.28, side: THREE.DoubleSide, depthWrite: false }),
    );
    disc.visible = false;
    rotor.add(disc);
    rotor.disc = disc;
    group.add(rotor);
    group.rotors.push(rotor);
  }
  return group;
}

// The rover in rover_body: its origin is the middle of the platform's surface.
export function makeRover(robot) {
  const group = new THREE.Group(), side = robot.platform.side, height = robot.platform.height;
  box([side, side, 0.04], [0, 0, 0.02], 0xf2f4f6, group);
  box([0.8 * side, 0.55 * side, 0.4 * height], [0, 0, 0.04 + 0.2 * height], 0x3c4653, group);
  box([0.12, 0.3 * side, 0.05], [0.44 * side, 0, 0.1], NOSE, group);
  const radius = 0.28 * height;
  for (const f of [0.42, 0, -0.42]) {
    for (const r of [1, -1]) {
      const wheel = new THREE.Mesh(
        new THREE.CylinderGeometry(radius, radius, 0.11, 20), new THREE.MeshStandardMaterial({ color: 0x1c2127, roughness: 0.9 }),
      );
      wheel.position.set(f * side, r * 0.42 * side, height - radius);
      wheel.castShadow = true;
      group.add(wheel);
      rod([f * side, 0, 0.5 * height], [f * side, r * 0.42 * side, height - radius], 0.02, 0x8794a3, group);
    }
  }
  const material = new THREE.MeshLambertMaterial({ map: new THREE.TextureLoader().load(robot.platform.picture) });
  material.map.colorSpace = THREE.SRGBColorSpace;
  material.map.anisotropy = 4;
  const top = new THREE.Mesh(new THREE.PlaneGeometry(side, side), material);
  top.position.z = -0.003;
  top.rotation.set(Math.PI, 0, Math.PI / 2); // the picture's top towards the rover's nose, its face up
  top.receiveShadow = true;
  group.add(top);
  return group;
}
