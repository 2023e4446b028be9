// Clicks on the ground of the 3D view, and the mark of the point that was clicked.
import { THREE } from "nicegui-scene";

const CLICK_PX = 5, FAR_M = 1000;

// Calls `onPoint([north, east])` for each click on the ground, or on the level beyond it; a drag turns the view.
export function watchGround(canvas, camera, ground, onPoint) {
  let start = null;
  canvas.addEventListener("pointerdown", (event) => (start = event.button === 0 ? [event.clientX, event.clientY] : null));
  canvas.addEventListener("pointerup", (event) => {
    if (!start || Math.hypot(event.clientX - start[0], event.clientY - start[1]) > CLICK_PX) return;
    const box = canvas.getBoundingClientRect(), ray = new THREE.Raycaster();
    const x = (2 * (event.clientX - box.left)) / box.width - 1, y = 1 - (2 * (event.clientY - box.top)) / box.height;
    ray.setFromCamera(new THREE.Vector2(x, y), camera);
    // The scene is east, north, up.
    const level = new THREE.Plane(new THREE.Vector3(0, 0, 1), 0);
    const at = ray.intersectObject(ground, true)[0]?.point ?? ray.ray.intersectPlane(level, new THREE.Vector3());
    if (!at || at.length() > FAR_M) return;
    onPoint([at.y, at.x].map((part) => Math.round(100 * part) / 100));
  });
}

// A ring and a line up to the flight's height; a child of the group with ned coordinates.
export function makeMark() {
  const mark = new THREE.Group(), color = 0xffd34d;
  const ring = new THREE.Mesh(new THREE.RingGeometry(0.28, 0.36, 32), new THREE.MeshBasicMaterial({ color, side: THREE.DoubleSide }));
  ring.position.z = -0.03;
  const stem = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color }));
  stem.frustumCulled = false;
  mark.add(ring, stem);
  mark.visible = false;
  mark.show = (point, height) => {
    mark.visible = !!point;
    if (!point) return;
    const [north, east, down = 0] = point;
    mark.position.set(north, east, -height);
    stem.geometry.setFromPoints([new THREE.Vector3(0, 0, 0), new THREE.Vector3(0, 0, Math.min(down + height, 0))]);
  };
  return mark;
}
