// The box on the page: its scene, its colours, and the part that is pointed at.
import { element, get, swatch } from "./page.js";

const LOCKED = "#8a6d3b", CONFLICT = "#d3212c", MARKED = "#404040", OTHER = "#b8b8b8";

export const canvas = get("scene");

// What is shown: `found` is a result or a preview of the server, `box` the number of its box.
export const shown = {
  found: null, box: 0, view: null, camera: null, controls: null,
  isBusy: false, locked: new Set(), conflicts: new Set(), pointed: null, chosen: null, kind: null,
};

let size = "";
let listRows = () => [];

export function buildView(rows) {
  listRows = rows;
  for (const name of ["apart", "cut"]) get(name).addEventListener("input", draw);
  get("coloring").addEventListener("change", () => {
    legend();
    paint();
  });
  new ResizeObserver(draw).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  if (!BoxScene.isPossible) canvas.replaceWith(element("p", "This browser has no WebGL: the box can't be shown.", { className: "failed" }));
}

export const hasScene = () => size !== "";

export const boxOf = () => shown.found.boxes[shown.box];

// Show a box, and all of it that reaches to `sides`, in box units.
export function show(found, box, sides) {
  Object.assign(shown, { found, box, pointed: null, chosen: null, kind: null });
  legend();
  if (!BoxScene.isPossible) return;
  const model = found.models.boxes[box];
  shown.view = BoxScene.build(model, found.models.shapes, (item) => item.colors.item);
  look(sides || model.size);
  paint();
}

// Look at a box of some size from the first place of the camera, unless it is the same size.
function look(sides) {
  if (String(sides) === size) return;
  if (shown.controls) shown.controls.dispose();
  Object.assign(shown, BoxScene.look(sides, canvas, draw));
  size = String(sides);
}

export function colorOf(part) {
  const kind = boxOf().kinds[part];
  if (kind === undefined) return OTHER;
  const own = get("coloring").value === "kind" && shown.found.kinds.find((each) => each.number === kind);
  return own ? own.color : shown.found.models.boxes[shown.box].items[part].colors.item;
}

export const nameOf = (part) => [...boxOf().parts, ...boxOf().others][part];

// Mark a part in the box and in the list.
export function point(part) {
  if (part === shown.pointed) return;
  shown.pointed = part;
  listRows().forEach((row, n) => row.classList.toggle("pointed", n === part));
  get("tip").hidden = part === null;
  if (part !== null) get("tip").textContent = nameOf(part) + (shown.conflicts.has(part) ? ": in conflict" : "");
  paint();
}

export function paint() {
  if (!shown.view) return;
  shown.view.items.forEach(({ mesh }, n) => {
    const color = shown.conflicts.has(n) ? CONFLICT : shown.locked.has(n) ? LOCKED : colorOf(n);
    mesh.material.color.set(color);
    const isMarked = n === shown.pointed || n === shown.chosen || (shown.kind !== null && boxOf().kinds[n] === shown.kind);
    mesh.material.emissive.set(isMarked ? MARKED : "#000000");
  });
  draw();
}

export function draw() {
  if (!shown.view || !shown.camera || !canvas.isConnected) return;
  BoxScene.apart(shown.view, shown.camera, Number(get("apart").value) / 100);
  BoxScene.cut(shown.view, Number(get("cut").value) / 100);
  BoxScene.draw(shown.view, shown.camera, canvas);
}

// The part at the pointer, or null.
export function partAt(event) {
  const item = shown.view && BoxScene.itemAt(event, shown.view, shown.camera, canvas);
  return item ? shown.view.items.indexOf(item) : null;
}

// Show what the colours mean: each kind of parts, and the states of parts.
export function legend() {
  const { found } = shown;
  const isByKind = get("coloring").value === "kind";
  const kinds = (isByKind && found ? found.kinds : []).map((kind) => {
    const button = element("button", null, { type: "button" }, swatch(kind.color), `${kind.name} \u00d7 ${kind.count}`);
    for (const [event, value] of [["pointerenter", kind.number], ["focus", kind.number], ["pointerleave", null], ["blur", null]]) {
      button.addEventListener(event, () => {
        shown.kind = value;
        paint();
      });
    }
    return element("li", null, {}, button);
  });
  const states = [
    [shown.locked.size, LOCKED, "locked"], [shown.conflicts.size, CONFLICT, "in conflict"],
    [found && boxOf().others.length, OTHER, "in the box already, or free"],
  ];
  const others = states.filter(([is]) => is).map(([, color, text]) => element("li", null, {}, swatch(color), text));
  get("legend").replaceChildren(...kinds, ...others);
}
