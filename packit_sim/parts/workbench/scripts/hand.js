// Moving parts by hand: with the pointer or by keys, checked by the server while they move.
import { attempt, get, say, send } from "./page.js";
import { axisAlong, forward, pointOn, ray } from "./rays.js";
import { snapped, stepped } from "./snapping.js";
import { boxOf, canvas, draw, legend, nameOf, paint, partAt, point, shown } from "./view.js";

const QUIET = 80; // milliseconds without a further move, after which the server is asked
const UP = new THREE.Vector3(0, 0, 1);

const moves = new Map(); // by the number of a part: its shift in the unit of the task, and its quarter turns
let isOn = false;
let key = ""; // of the packing that is shown
let grip = null; // what the pointer holds
let timer = 0;
let checking = null; // the check that runs, or was the last one
let waiting = false; // for the server to accept the places
let poll = () => {};

export const isMoving = () => moves.size > 0;

const scale = () => Math.max(...shown.found.models.boxes[shown.box].size) / Math.max(...boxOf().sides);

export function buildHand(onPoll) {
  poll = onPoll;
  get("hand").addEventListener("click", () => toggle(!isOn));
  canvas.addEventListener("pointerdown", grab, true);
  canvas.addEventListener("pointermove", drag);
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, release);
}

export function toggle(on, part = null) {
  if (on && get("hand").disabled) return;
  isOn = on;
  get("hand").setAttribute("aria-pressed", String(isOn));
  if (isOn) for (const name of ["apart", "cut"]) get(name).value = 0;
  if (!isOn) putBack();
  choose(isOn ? part : null);
  if (isOn) {
    canvas.focus();
    explain();
  }
}

function explain() {
  const who = shown.chosen === null ? "Drag a part, or choose one with N" : `${nameOf(shown.chosen)}: drag it, or use the arrow keys, Page Up, Page Down and R`;
  say(`${who}; Enter accepts, Escape puts it back.`);
}

function choose(part) {
  shown.chosen = part;
  point(part);
  paint();
}

// Begin with another packing, in which nothing is moved.
export function reset(packing) {
  key = packing;
  moves.clear();
  waiting = false;
  settle([]);
}

// Show that the server has refused the places that it was asked to accept.
export function refused(message) {
  if (!waiting) return;
  waiting = false;
  settle([{ parts: [...moves.keys()], text: message.replace(/^error: /, "") }]);
}

// The corners of a part where it is now, in the unit of the task.
function corners(part) {
  const { low, high } = boxOf();
  const { turns } = moves.get(part) || { turns: 0 };
  const shift = moves.has(part) ? moves.get(part).shift : [0, 0, 0];
  const middle = home(part).map((each) => each / scale());
  let [from, to] = [low[part].map((each, k) => each - middle[k]), high[part].map((each, k) => each - middle[k])];
  for (let n = 0; n < turns; n++) [from, to] = [[-to[1], from[0], from[2]], [-from[1], to[0], to[2]]];
  return [from, to].map((corner) => corner.map((each, k) => each + middle[k] + shift[k]));
}

// The middle of a part before it was moved, in box units.
function home(part) {
  const { pose } = shown.view.items[part];
  return [pose[3], pose[7], pose[11]];
}

function move(part, by, turns = 0) {
  const before = moves.get(part) || { shift: [0, 0, 0], turns: 0 };
  moves.set(part, { shift: before.shift.map((each, k) => each + by[k]), turns: (before.turns + turns) % 4 });
  place(part);
  clearTimeout(timer);
  timer = setTimeout(check, QUIET);
}

function place(part) {
  const { mesh, pose } = shown.view.items[part];
  const { shift, turns } = moves.get(part) || { shift: [0, 0, 0], turns: 0 };
  mesh.userData.home.fromArray(home(part)).add(new THREE.Vector3(...shift).multiplyScalar(scale()));
  new THREE.Matrix4().set(...pose, 0, 0, 0, 1).decompose(mesh.position, mesh.quaternion, mesh.scale);
  for (let n = 0; n < turns; n++) mesh.rotateOnWorldAxis(UP, Math.PI / 2);
  draw();
}

function putBack(part = null) {
  const numbers = part === null ? [...moves.keys()] : [part];
  for (const number of numbers) {
    moves.delete(number);
    place(number);
  }
  check();
}

const body = (accept) => ({ packing: key, box: shown.box, accept, moves: [...moves].map(([part, own]) => ({ part, ...own })) });

// Ask the server for the conflicts, once at a time; return whether there are none.
async function check() {
  clearTimeout(timer);
  if (!moves.size) return settle([]);
  const asked = body(false);
  const before = checking;
  checking = (async () => {
    await before;
    try {
      return (await send("/moves", asked)).conflicts;
    } catch (error) {
      return [{ parts: [...moves.keys()], text: error.message }];
    }
  })();
  const found = await checking;
  return JSON.stringify(asked) === JSON.stringify(body(false)) ? settle(found) : false;
}

function settle(found) {
  shown.conflicts = new Set(found.flatMap((each) => each.parts));
  get("conflict").textContent = found.length ? `${found.map((each) => each.text).slice(0, 3).join("; ")}. Move it on, or press Escape to put it back.` : "";
  document.body.classList.toggle("moving", moves.size > 0);
  document.querySelectorAll("#locks li").forEach((row, n) => row.classList.toggle("conflict", shown.conflicts.has(n)));
  enable();
  legend();
  paint();
  return !found.length;
}

// Let nothing be packed or written while the server works, or parts are not where it has them.
export function enable() {
  get("pack").disabled = get("write").disabled = shown.isBusy || moves.size > 0;
  get("hand").disabled = shown.isBusy || !key || !BoxScene.isPossible;
}

async function accept() {
  if (!moves.size || waiting || !(await check())) return;
  waiting = true;
  if (!(await attempt("/moves", body(true)))) waiting = false;
  await poll();
}

function grab(event) {
  if (!isOn || waiting || event.button) return;
  const part = partAt(event);
  if (part === null || part >= boxOf().parts.length) return;
  event.stopImmediatePropagation(); // it does not rotate the box
  canvas.setPointerCapture(event.pointerId);
  canvas.focus();
  choose(part);
  explain();
  const [hit] = ray(event).intersectObject(shown.view.items[part].mesh, false);
  const at = hit ? hit.point : shown.view.items[part].mesh.position.clone();
  grip = { part, at, start: corners(part)[0] };
}

function drag(event) {
  if (!grip) return;
  const isUp = event.shiftKey;
  const now = pointOn(event, grip.at, isUp ? forward().negate() : UP);
  if (!now) return;
  const wanted = now.sub(grip.at).divideScalar(scale()).toArray();
  const axes = isUp ? [2] : [0, 1];
  const is = corners(grip.part);
  const by = [0, 1, 2].map((axis) => (axes.includes(axis) ? grip.start[axis] + wanted[axis] - is[0][axis] : 0));
  const there = is.map((corner) => corner.map((each, k) => each + by[k]));
  const snap = snapped(shown.found, boxOf(), grip.part, there, axes);
  move(grip.part, by.map((each, k) => each + snap[k]));
}

function release() {
  if (!grip) return;
  grip = null;
  accept();
}

// Do what a key says while parts are moved by hand; return whether it says something.
export function press(event) {
  if (!isOn || waiting || event.ctrlKey || event.metaKey || event.altKey) return false;
  const count = boxOf().parts.length;
  const name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (name === "n" || name === "p") {
    const first = name === "n" ? 0 : count - 1;
    choose(shown.chosen === null ? first : (shown.chosen + (name === "n" ? 1 : count - 1)) % count);
    explain();
    return true;
  }
  if (name === "Escape") {
    if (!moves.size) toggle(false);
    else putBack(moves.has(shown.chosen) ? shown.chosen : null);
    return true;
  }
  if (name === "Enter") {
    accept();
    return true;
  }
  if (shown.chosen === null) return false;
  const axes = {
    ArrowRight: () => axisAlong(true), ArrowLeft: () => axisAlong(true).map((each, n) => (n ? -each : each)),
    ArrowUp: () => axisAlong(false), ArrowDown: () => axisAlong(false).map((each, n) => (n ? -each : each)),
    PageUp: () => [2, 1], PageDown: () => [2, -1],
  };
  if (name === "r") move(shown.chosen, [0, 0, 0], 1);
  else if (name in axes) {
    const [axis, sign] = axes[name]();
    const by = [0, 0, 0];
    by[axis] = stepped(shown.found, boxOf(), shown.chosen, corners(shown.chosen), axis, sign * (event.shiftKey ? 10 : 1));
    move(shown.chosen, by);
  } else return false;
  return true;
}
