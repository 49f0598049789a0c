// The workbench: sends files and orders, shows what the server has, and lets parts be locked.
"use strict";
(() => {
  const POLL = 500; // milliseconds
  const LOCKED = "#8a6d3b", MARKED = "#404040";
  const TURNS = { cube: "any way up", upright: "upright", fixed: "as in the file" };
  const get = (id) => document.getElementById(id);
  const form = get("order").elements;
  const canvas = get("scene");
  const asked = new Map(); // by the number of a file: how many, and how they may turn
  const UNITS = ["mm", "cm", "in", "m"];
  let seen = -1;
  let packing = ""; // which one is shown
  let result = null;
  let view, camera, controls, size;
  let locked = new Set();
  let shownParts = []; // the names of the parts in the scene
  let pointed = null; // the part under the pointer or the focus, in the box or in the list
  let isLoaded = false;
  let shownFiles = "[]";

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
    get("message").classList.toggle("done", /^done/.test(text));
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
      if (!file["own unit"]) name.append(unitOf(file));
      const count = element("input", null, { type: "number", min: 0, max: 10000, step: 1, value: own.count });
      count.setAttribute("aria-label", `How many of ${file.name}`);
      count.addEventListener("input", () => {
        own.count = Math.max(0, Math.trunc(Number(count.value)));
        keep();
      });
      const turns = element("select", null);
      turns.setAttribute("aria-label", `How ${file.name} may turn`);
      for (const [value, text] of Object.entries(TURNS)) turns.append(element("option", text, { value }));
      turns.value = own.rotations;
      turns.addEventListener("change", () => {
        own.rotations = turns.value;
        keep();
      });
      const remove = element("button", "\u00d7", { type: "button" });
      remove.setAttribute("aria-label", `Remove ${file.name}`);
      remove.addEventListener("click", async () => {
        asked.delete(file.number);
        keep();
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

  // A choice of the unit in which a file is read that does not define one.
  function unitOf(file) {
    const unit = element("select", null);
    unit.setAttribute("aria-label", `Unit of ${file.name}`);
    for (const name of UNITS) unit.append(element("option", name));
    unit.value = file.unit;
    unit.addEventListener("change", async () => {
      try {
        await send("/unit", JSON.stringify({ number: file.number, unit: unit.value }));
      } catch (error) {
        say(error.message, true);
      }
      await poll();
    });
    const label = element("label", "read in ", { className: "unit" });
    label.append(unit);
    return label;
  }

  function order() {
    const [x, y, z] = ["x", "y", "z"].map((name) => form[name].value);
    return {
      box: `${x}x${y}x${z}`,
      unit: form.unit.value,
      objective: form.objective.value,
      clearance: form.clearance.value || "0",
      wall_clearance: form.wall.value || "0",
      seconds: Number(form.seconds.value) || 30,
      instructions: form.instructions.checked,
      files: [...asked].map(([number, own]) => ({ number, ...own })),
    };
  }

  // Keep the order on the server, so that a reload of the page brings it back.
  function keep() {
    if (!isLoaded) return;
    send("/order", JSON.stringify(order())).then(showPreview, (error) => say(error.message, true));
  }

  // Show the box with the parts in front of it, until there is a packing.
  function showPreview(found) {
    const isBox = ["x", "y", "z"].every((name) => Number(form[name].value) > 0);
    get("fault").textContent = isBox ? found.fault || "" : "Each side of the box must be a number above 0.";
    if (result || found.fault || !BoxScene.isPossible) return;
    const [box] = found.models.boxes;
    shownParts = found.parts;
    view = BoxScene.build(box, found.models.shapes, (item) => item.colors.item);
    look(found.reach);
    paint();
  }

  // Look at a box of some size from the first place of the camera, unless it is the same size.
  function look(sides) {
    if (String(sides) === size) return;
    if (controls) controls.dispose();
    ({ camera, controls } = BoxScene.look(sides, canvas, draw));
    size = String(sides);
  }

  function restore(kept) {
    [form.x.value, form.y.value, form.z.value] = kept.box.split("x");
    for (const name of ["unit", "objective", "clearance", "seconds"]) form[name].value = kept[name];
    form.wall.value = kept.wall_clearance;
    form.instructions.checked = kept.instructions;
    for (const { number, count, rotations } of kept.files) asked.set(number, { count, rotations });
  }

  function showResult(found) {
    result = found;
    const number = get("number");
    const before = number.value;
    number.replaceChildren(...found.boxes.map((box, n) => element("option", `${n + 1}: ${box.name}`, { value: n })));
    if (Number(before) < found.boxes.length) number.value = before || "0";
    get("choice").hidden = found.boxes.length < 2;
    get("result").hidden = false;
    const links = found.downloads.map((name) => element("a", name, { href: `/files/${encodeURIComponent(name)}`, download: name }));
    if (links.length) links.unshift(element("a", "all files (.zip)", { href: "/packing.zip", download: "packing.zip", className: "all" }));
    get("downloads").replaceChildren(...links);
    get("write").hidden = links.length > 0;
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
    const canLock = result["can lock"];
    shownParts = result.boxes[n].parts;
    const rows = result.boxes[n].parts.map((name, part) => {
      const row = element("li", null);
      const label = element("label", null);
      const box = element("input", null, { type: "checkbox", checked: locked.has(part), disabled: !canLock });
      box.addEventListener("change", () => lock(part, box.checked));
      row.addEventListener("pointerenter", () => point(part));
      row.addEventListener("pointerleave", () => point(null));
      box.addEventListener("focus", () => point(part));
      box.addEventListener("blur", () => point(null));
      label.append(box, swatch(result.models.boxes[n].items[part].colors.item), name);
      row.append(label);
      return row;
    });
    get("locks").querySelector("ol").replaceChildren(...rows);
    if (!BoxScene.isPossible) return;
    const box = result.models.boxes[n];
    view = BoxScene.build(box, result.models.shapes, (item) => item.colors.item);
    look(box.size);
    paint();
  }

  function swatch(color) {
    const shown = element("span", null, { className: "swatch" });
    shown.style.background = color;
    return shown;
  }

  async function lock(part, isLocked) {
    try {
      await send("/lock", JSON.stringify({ part, locked: isLocked }));
    } catch (error) {
      say(error.message, true);
    }
    await poll();
  }

  function showLocks(numbers) {
    locked = new Set(numbers);
    get("locks").querySelectorAll("input").forEach((box, n) => { box.checked = locked.has(n); });
    paint();
  }

  // Mark a part in the box and in the list.
  function point(part) {
    if (part === pointed) return;
    pointed = part;
    const rows = [...get("locks").querySelectorAll("li")];
    rows.forEach((row, n) => row.classList.toggle("pointed", n === part));
    get("tip").hidden = part === null;
    if (part !== null) get("tip").textContent = shownParts[part];
    paint();
  }

  function paint() {
    if (!view) return;
    view.items.forEach(({ mesh, colors }, n) => {
      mesh.material.color.set(locked.has(n) ? LOCKED : colors.item);
      mesh.material.emissive.set(n === pointed ? MARKED : "#000000");
    });
    draw();
  }

  function draw() {
    if (!view || !camera) return;
    BoxScene.apart(view, camera, Number(get("apart").value) / 100);
    BoxScene.cut(view, Number(get("cut").value) / 100);
    BoxScene.draw(view, camera, canvas);
  }

  async function step(name) {
    if (get(name).disabled) return;
    try {
      await send(`/${name}`);
    } catch (error) {
      say(error.message, true);
    }
    await poll();
  }

  async function poll() {
    const query = new URLSearchParams({ seen, packing });
    const state = await (await fetch(`/state?${query}`)).json();
    if (state.version < seen) return; // an answer that another one overtook
    get("pack").disabled = state.busy;
    get("stop").disabled = !state.busy;
    if (state.version === seen) return;
    seen = state.version;
    get("undo").disabled = !state.undo;
    get("redo").disabled = !state.redo;
    if (!isLoaded && state.order) restore(state.order);
    isLoaded = true;
    if (state.message || !/^sending/.test(get("message").textContent)) say(state.message);
    const files = JSON.stringify(state.files);
    if (files !== shownFiles) showFiles(state.files);
    if (files !== shownFiles || !size) keep();
    shownFiles = files;
    if (state.result) {
      packing = state.packing;
      pointed = null;
      showResult(state.result);
    }
    if (result) showLocks(state.locked);
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
    try {
      await send("/pack", JSON.stringify(order()));
      await poll();
    } catch (error) {
      say(error.message, true);
    }
  });
  get("order").addEventListener("change", keep);
  get("stop").addEventListener("click", () => send("/stop"));
  for (const name of ["undo", "redo"]) get(name).addEventListener("click", () => step(name));
  get("write").addEventListener("click", async () => {
    try {
      await send("/write", JSON.stringify({ instructions: form.instructions.checked }));
    } catch (error) {
      say(error.message, true);
    }
    await poll();
  });
  for (const name of ["apart", "cut"]) get(name).addEventListener("input", draw);
  addEventListener("keydown", (event) => {
    const isText = event.target.matches("input:not([type=checkbox]):not([type=range]), select");
    if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z" || isText) return;
    event.preventDefault();
    step(event.shiftKey ? "redo" : "undo");
  });
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
    point(item ? view.items.indexOf(item) : null);
  });
  canvas.addEventListener("pointerleave", () => point(null));
  let pressed = null;
  canvas.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; });
  canvas.addEventListener("click", (event) => {
    if (!view || !result || !result["can lock"] || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 4) return;
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
