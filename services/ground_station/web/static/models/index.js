// Meshes of vehicle, rover and ground. All are in jezero's own axes: frd (forward, right, down) and ned.
import { THREE } from "nicegui-scene";

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
  for (const tag of robot.platform.tags) {
    const material = new THREE.MeshBasicMaterial({ color: tag.image ? 0xffffff : 0x101010 });
    if (tag.image) {
      material.map = new THREE.TextureLoader().load(tag.image);
      material.map.magFilter = THREE.NearestFilter;
      material.map.colorSpace = THREE.SRGBColorSpace;
    }
    const square = new THREE.Mesh(new THREE.PlaneGeometry(tag.side, tag.side), material);
    const [forward, right] = tag.pos;
    square.position.set(forward, right, -0.002 - 0.0005 * robot.platform.tags.indexOf(tag));
    square.rotation.set(Math.PI, 0, -Math.PI / 2); // the image's top towards the rover's nose, its face up
    group.add(square);
  }
  return group;
}

// Ground in ned from heights (positive up), rows to the north; a level square without heights.
export function makeGround(ground) {
  const group = new THREE.Group();
  const points = ground ? ground.points : 2, half = ground ? ground.half : 250;
  const [north0, east0, down0] = ground ? ground.offset : [0, 0, 0];
  const positions = [], colors = [], indices = [];
  const low = new THREE.Color(0x7a3f26), high = new THREE.Color(0xc98a5a), color = new THREE.Color();
  for (let row = 0; row < points; row++) {
    for (let column = 0; column < points; column++) {
      const height = ground ? ground.heights[row * points + column] : 0;
      const step = (2 * half) / (points - 1);
      positions.push(-half + row * step + north0, -half + column * step + east0, -height + down0);
      const grain = 0.5 + 0.5 * Math.sin(12.9898 * row + 78.233 * column) * Math.cos(4.1 * row - 9.7 * column);
      color.lerpColors(low, high, Math.min(1, Math.max(0, 0.45 + 0.7 * height + 0.16 * (grain - 0.5))));
      colors.push(color.r, color.g, color.b);
    }
  }
  for (let row = 0; row + 1 < points; row++) {
    for (let column = 0; column + 1 < points; column++) {
      const a = row * points + column, b = a + 1, c = a + points, d = c + 1;
      indices.push(a, b, c, b, d, c);
    }
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(positions, 3));
  geometry.setAttribute("color", new THREE.Float32BufferAttribute(colors, 3));
  geometry.setIndex(indices);
  geometry.computeVertexNormals();
  const material = new THREE.MeshStandardMaterial({ vertexColors: true, roughness: 1, side: THREE.DoubleSide });
  const mesh = new THREE.Mesh(geometry, material);
  mesh.receiveShadow = true;
  group.add(mesh);
  if (ground && ground.rocks.length) group.add(makeRocks(ground));
  return group;
}

// Rocks as (3 n,) coordinates of triangles' corners in the simulator's map.
function makeRocks(ground) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(ground.rocks, 3));
  geometry.computeVertexNormals();
  const rocks = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ color: 0x6b4636, roughness: 0.95, flatShading: true, side: THREE.DoubleSide }));
  rocks.position.set(...ground.offset);
  rocks.castShadow = rocks.receiveShadow = true;
  return rocks;
}
