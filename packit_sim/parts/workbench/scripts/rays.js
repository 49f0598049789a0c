// Directions of the screen in the box, and the points at which the pointer is.
import { canvas, shown } from "./view.js";

export function ray(event) {
  const frame = canvas.getBoundingClientRect();
  const at = new THREE.Vector2((2 * (event.clientX - frame.x)) / frame.width - 1, 1 - (2 * (event.clientY - frame.y)) / frame.height);
  const made = new THREE.Raycaster();
  made.setFromCamera(at, shown.camera);
  return made;
}

// The point of the plane through a point, with a normal, at which the pointer is; null if there is none.
export function pointOn(event, through, normal) {
  const { origin, direction } = ray(event).ray;
  const slope = direction.dot(normal);
  const far = through.clone().sub(origin).dot(normal) / slope;
  return Math.abs(slope) > 1e-6 && far > 0 ? direction.clone().multiplyScalar(far).add(origin) : null;
}

// The horizontal direction away from the viewer.
export function forward() {
  const toward = shown.controls.target.clone().sub(shown.camera.position);
  toward.z = 0;
  return toward.normalize();
}

// The axis of the box along which a direction of the screen points most, with its sign: to the right, or away.
export function axisAlong(isRight) {
  const { x, y } = forward();
  const way = isRight ? [y, -x] : [x, y];
  return Math.abs(way[0]) > Math.abs(way[1]) ? [0, Math.sign(way[0])] : [1, Math.sign(way[1])];
}
