// The keys of the page, and the dialog that lists them.
import { element, get } from "./page.js";
import { press, toggle } from "./hand.js";
import { canLock, lock } from "./result.js";
import { canvas, draw, shown } from "./view.js";

const KEYS = [
  ["?", "this list"],
  ["Ctrl+Z, Ctrl+Shift+Z", "take the last result back, and bring it again"],
  ["Arrow keys, + and -", "with the box in focus: rotate it, zoom"],
  ["M", "with the box in focus: move parts by hand, or no longer"],
  ["N and P", "while parts are moved: choose the next or the part before"],
  ["Arrow keys", "move the chosen part along the floor by 1 mm, with Shift by 10 mm; it stops where it touches"],
  ["Page Up, Page Down", "move it up and down"],
  ["R", "turn it by a quarter"],
  ["L", "lock it, or unlock it"],
  ["Enter", "accept where it is, if it is in no conflict"],
  ["Escape", "put it back; again: move no more"],
  ["Drag, Shift+drag", "move a part along the floor, and up and down"],
];

export function buildKeys(step) {
  const dialog = get("keys");
  dialog.querySelector("tbody").replaceChildren(...KEYS.map(([keys, text]) =>
    element("tr", null, {}, element("th", keys, { scope: "row" }), element("td", text, { className: "text" }))));
  get("help").addEventListener("click", () => dialog.showModal());
  addEventListener("keydown", (event) => {
    const isText = event.target.matches("input:not([type=checkbox]):not([type=range]), select");
    if (event.key === "?" && !isText && !dialog.open) dialog.showModal();
    if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z" || isText) return;
    event.preventDefault();
    step(event.shiftKey ? "redo" : "undo");
  });
  canvas.addEventListener("keydown", (event) => {
    const { camera, controls, chosen } = shown;
    if (!camera) return;
    const name = event.key.toLowerCase();
    if (press(event)) event.preventDefault();
    else if (event.ctrlKey || event.metaKey || event.altKey) return;
    else if (name === "m") toggle(get("hand").getAttribute("aria-pressed") === "false");
    else if (name === "l" && chosen !== null && canLock()) lock(chosen, !shown.locked.has(chosen));
    else if (BoxScene.turn(event.key, camera, controls)) {
      event.preventDefault();
      draw();
    }
  });
}
