// The workbench: sends files and orders, shows what the server has, and lets parts be locked.
"use strict";
(() => {
  const POLL = 500; // milliseconds
  const LOCKED = "#8a6d3b";
  const TURNS = { cube: "any way up", upright: "upright", fixed: "as in the file" };
  const get = (id) => document.getElementById(id);
  const form = get("order").elements;
  const canvas = get("scene");
  const asked = new Map(); // by the number of a file: how many, and how they may turn
  let seen = -1;
  let result = null;
  let view, camera, controls, size;
  let locked = new Set();

  async function send(path, body) {
    const answer = await fetch(path, { method: "POST", body });
    const found = await answer.json();
    if (!answer.ok) throw new Error(found.error);
    return found;
  }

  function element(tag, text, more = {}) {
    return Object.assign(document.createElement(tag), text === null ? {} : { textContent: text }, more);
  }

  function say(text, isError = false) {
    get("message").textContent = text;
    get("message").classList.toggle("error", isError || /^(unexpected )?error:/.test(text));
  }

  async function add(files) {
    get("refused").replaceChildren();
    for (const file of files) {
      say(`sending ${file.name}`);
      const query = new URLSearchParams({ name: file.name, unit: form.unit.value });
      try {
        await send(`/parts?${query}`, file);
      } catch (error) {
        get("refused").append(element("li", error.message));
      }
    }
    say("");
    await poll();
  }

  function showFiles(files) {
    const rows = files.map((file) => {
      const own = asked.get(file.number) || { count: 1, rotations: "cube" };
      asked.set(file.number, own);
      const row = element("tr", null);
      row.dataset.number = file.number;
      const name = element("th", file.name, { scope: "row" });
      name.append(element("small", file.parts > 1 ? `${file.parts} parts: ${file.size}` : file.size));
      const count = element("input", null, { type: "number", min: 0, max: 10000, step: 1, value: own.count });
      count.setAttribute("aria-label", `How many of ${file.name}`);
      count.addEventListener("input", () => { own.count = Math.max(0, Math.trunc(Number(count.value))); });
      const turns = element("select", null);
      turns.setAttribute("aria-label", `How ${file.name} may turn`);
      for (const [value, text] of Object.entries(TURNS)) turns.append(element("option", text, { value }));
      turns.value = own.rotations;
      turns.addEventListener("change", () => { own.rotations = turns.value; });
      const remove = element("button", "\u00d7", { type: "button" });
      remove.setAttribute("aria-label", `Remove ${file.name}`);
      remove.addEventListener("click", async () => {
        asked.delete(file.number);
        await send("/remove", JSON.stringify({ number: file.number }));
        await poll();
      });
      const cells = [count, turns, remove].map((one) => {
        const cell = element("td", null);
        cell.append(one);
        return cell;
      });
      row.append(name, ...cells);
      return row;
    });
    get("files").hidden = !files.length;
    get("files").tBodies[0].replaceChildren(...rows);
  }

  function showResult(found) {
    result = found;
    locked = new Set(Array.from({ length: found.locked }, (_, n) => n));
    const number = get("number");
    const before = number.value;
    number.replaceChildren(...found.boxes.map((box, n) => element("option", `${n + 1}: ${box.name}`, { value: n })));
    if (Number(before) < found.boxes.length) number.value = before || "0";
    get("choice").hidden = found.boxes.length < 2;
    get("result").hidden = false;
    const links = found.downloads.map((name) => element("a", name, { href: `/files/${encodeURIComponent(name)}`, download: name }));
    get("downloads").replaceChildren(...links);
    get("left").replaceChildren(...found["left out"].map((text) => element("li", `left out: ${text}`)));
    const words = [...found.problems.map((text) => `problem: ${text}`), ...found.notes];
    get("notes").replaceChildren(...words.map((text) => element("li", text)));
    const rows = Object.entries(found.summary).map(([name, value]) => {
      const row = element("tr", null);
      row.append(element("th", name, { scope: "row" }), element("td", value, { className: "text" }));
      return row;
    });
    get("summary").tBodies[0].replaceChildren(...rows);
    showBox();
  }

  function showBox() {
    const n = Number(get("number").value);
    const canLock = result.boxes.length === 1;
    const rows = result.boxes[n].parts.map((name, part) => {
      const row = element("li", null);
      const label = element("label", null);
      const box = element("input", null, { type: "checkbox", checked: locked.has(part), disabled: !canLock });
      box.addEventListener("change", () => lock(part, box.checked));
      label.append(box, name);
      row.append(label);
      return row;
    });
    get("locks").querySelector("ol").replaceChildren(...rows);
    if (!BoxScene.isPossible) return;
    const box = result.models.boxes[n];
    view = BoxScene.build(box, result.models.shapes, (item) => item.colors.item);
    if (String(box.size) !== size) {
      if (controls) controls.dispose();
      ({ camera, controls } = BoxScene.look(box.size, canvas, draw));
      size = String(box.size);
    }
    paint();
  }

  function lock(part, isLocked) {
    if (isLocked) locked.add(part);
    else locked.delete(part);
    get("locks").querySelectorAll("input")[part].checked = isLocked;
    paint();
  }

  function paint() {
    if (!view) return;
    view.items.forEach(({ mesh, colors }, n) => mesh.material.color.set(locked.has(n) ? LOCKED : colors.item));
    draw();
  }

  function draw() {
    if (view && camera) BoxScene.draw(view, camera, canvas);
  }

  async function poll() {
    const state = await (await fetch(`/state?seen=${seen}`)).json();
    if (state.version < seen) return; // an answer that another one overtook
    get("pack").disabled = state.busy;
    get("stop").disabled = !state.busy;
    if (state.version === seen) return;
    seen = state.version;
    if (state.message || !/^sending/.test(get("message").textContent)) say(state.message);
    const known = String([...get("files").tBodies[0].rows].map((row) => row.dataset.number));
    if (String(state.files.map(({ number }) => number)) !== known) showFiles(state.files);
    if (state.result) showResult(state.result);
  }

  async function watch() {
    try {
      await poll();
    } catch {
      say("the server does not answer: is the command still running?", true);
    }
    setTimeout(watch, POLL);
  }

  get("order").addEventListener("submit", async (event) => {
    event.preventDefault();
    const [x, y, z] = ["x", "y", "z"].map((name) => form[name].value);
    const order = {
      box: `${x}x${y}x${z}`,
      unit: form.unit.value,
      objective: form.objective.value,
      clearance: form.clearance.value || "0",
      wall_clearance: form.wall.value || "0",
      seconds: Number(form.seconds.value),
      instructions: form.instructions.checked,
      files: [...asked].map(([number, own]) => ({ number, ...own })),
      locked: [...locked],
    };
    try {
      await send("/pack", JSON.stringify(order));
      await poll();
    } catch (error) {
      say(error.message, true);
    }
  });
  get("stop").addEventListener("click", () => send("/stop"));
  get("choose").addEventListener("change", async (event) => {
    await add([...event.target.files]);
    event.target.value = "";
  });
  get("number").addEventListener("change", showBox);
  addEventListener("dragover", (event) => {
    event.preventDefault();
    get("drop").classList.add("over");
  });
  addEventListener("dragleave", () => get("drop").classList.remove("over"));
  addEventListener("drop", (event) => {
    event.preventDefault();
    get("drop").classList.remove("over");
    add([...event.dataTransfer.files]);
  });
  canvas.addEventListener("keydown", (event) => {
    if (!camera || !BoxScene.turn(event.key, camera, controls)) return;
    event.preventDefault();
    draw();
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!view || event.buttons) return;
    const item = BoxScene.itemAt(event, view, camera, canvas);
    get("tip").hidden = !item;
    if (item) get("tip").textContent = result.boxes[Number(get("number").value)].parts[view.items.indexOf(item)];
  });
  canvas.addEventListener("pointerleave", () => { get("tip").hidden = true; });
  let pressed = null;
  canvas.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; });
  canvas.addEventListener("click", (event) => {
    if (!view || result.boxes.length > 1 || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 4) return;
    const item = BoxScene.itemAt(event, view, camera, canvas);
    if (!item) return;
    const part = view.items.indexOf(item);
    lock(part, !locked.has(part));
  });
  new ResizeObserver(draw).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  if (!BoxScene.isPossible) canvas.replaceWith(element("p", "This browser has no WebGL: the box can't be shown.", { className: "failed" }));
  watch();
})();
