// What the camera sees: the edges of its view, and the part of the ground that is in the picture.
import { THREE } from "nicegui-scene";

const REACH_M = 30;
const POINTS_PER_EDGE = 6;
const LIFT_M = 0.03; // over the ground, so that it is not hidden by it
const CORNERS = [[-1, -1], [1, -1], [1, 1], [-1, 1]];

export class CameraView {
  constructor(optics, ground) {
    this.optics = optics;
    this.ground = ground;
    this.group = new THREE.Group();
    const edge = { color: 0xffffff, transparent: true, fog: false, depthWrite: false };
    this.edges = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ ...edge, opacity: 0.5 }));
    this.outline = new THREE.LineLoop(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ ...edge, opacity: 0.95 }));
    this.patch = new THREE.Mesh(new THREE.BufferGeometry(), new THREE.MeshBasicMaterial({ ...edge, opacity: 0.16, side: THREE.DoubleSide }));
    for (const part of [this.edges, this.outline, this.patch]) {
      part.frustumCulled = false;
      this.group.add(part);
    }
  }
  // `camera`: attitude of the camera's axes (right, down, forward) in frd, as [w, x, y, z]; null at rest.
  update(position, attitude, camera) {
    const { pos, turn, q_rest } = this.optics, [w, x, y, z] = camera ?? q_rest;
    const from = new THREE.Vector3(...pos).applyQuaternion(attitude).add(position);
    const aim = attitude.clone().multiply(new THREE.Quaternion(x, y, z, w));
    aim.multiply(new THREE.Quaternion().setFromAxisAngle(new THREE.Vector3(0, 0, 1), turn));
    const { tan_right, tan_down } = this.optics, rim = [];
    CORNERS.forEach(([right, down], i) => {
      const [nextRight, nextDown] = CORNERS[(i + 1) % 4];
      for (let k = 0; k < POINTS_PER_EDGE; k++) {
        const share = k / POINTS_PER_EDGE;
        const ray = new THREE.Vector3((right + share * (nextRight - right)) * tan_right, (down + share * (nextDown - down)) * tan_down, 1);
        rim.push(this.spot(from, ray.normalize().applyQuaternion(aim)));
      }
    });
    const middle = this.spot(from, new THREE.Vector3(0, 0, 1).applyQuaternion(aim));
    this.edges.geometry.setFromPoints([0, 1, 2, 3].flatMap((i) => [from, rim[i * POINTS_PER_EDGE]]));
    this.outline.geometry.setFromPoints(rim);
    this.patch.geometry.setFromPoints(rim.flatMap((point, i) => [middle, point, rim[(i + 1) % rim.length]]));
  }
  spot(from, ray) {
    const point = this.ground.meet(from, ray, REACH_M);
    point.z -= LIFT_M;
    return point;
  }
}
