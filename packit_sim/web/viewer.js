// The cards of a report: a box each, drawn when it changes.
"use strict";
(() => {
  const models = document.getElementById("models");
  const data = JSON.parse(models.textContent);
  const PERCENT = 100;

  const cards = [...document.querySelectorAll(".card")].map((figure) => new Card(figure));
  const coloring = document.getElementById("coloring");
  const ramp = document.getElementById("ramp");
  coloring.addEventListener("change", () => {
    const ends = { order: ["first", "last"], share: ["0%", "the largest share"] }[coloring.value];
    ramp.hidden = !ends;
    if (ends) [ramp.firstElementChild.textContent, ramp.lastElementChild.textContent] = ends;
    cards.forEach((card) => card.paint());
    swatch();
  });
  const names = [...document.querySelectorAll(".names button")];
  let chosen = null;
  names.forEach((name) => {
    name.addEventListener("pointerenter", () => mark(name));
    name.addEventListener("pointerleave", () => mark(chosen));
    name.addEventListener("focus", () => mark(name));
    name.addEventListener("blur", () => mark(chosen));
    name.addEventListener("keydown", (event) => { if (event.key === "Escape") choose(null); });
    name.addEventListener("click", () => choose(name === chosen ? null : name));
  });
  swatch();

  function choose(name) {
    chosen = name;
    names.forEach((one) => one.setAttribute("aria-pressed", String(one === chosen)));
    mark(chosen);
  }

  // Show the parts of a name, and all others like glass; all parts as they are without a name.
  function mark(name) {
    const copies = name && new Set(name.dataset.copies.split(" "));
    cards.forEach((card) => card.mark(copies));
  }

  // Give each name the colour of its first part.
  function swatch() {
    names.forEach((name) => {
      const [box, item] = name.dataset.copies.split(" ")[0].split(":").map(Number);
      name.style.setProperty("--swatch", data.boxes[box].items[item].colors[coloring.value]);
    });
  }

  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => cards.forEach((card) => card.draw()));
  addEventListener("beforeprint", () => cards.forEach((card) => card.draw()));

  function Card(figure) {
    const canvas = figure.querySelector("canvas");
    const by = figure.querySelector("select");
    const step = figure.querySelector(".step");
    const apart = figure.querySelector(".apart");
    const tip = figure.querySelector(".tip");
    let view, camera, controls;
    let marked = null;
    let seen = false;
    let waiting = false;

    this.draw = draw;
    this.mark = (copies) => {
      marked = copies;
      later();
    };
    this.paint = () => {
      if (view) view.items.forEach((item) => item.mesh.material.color.set(item.colors[coloring.value]));
      later();
    };
    if (!BoxScene.isPossible) {
      const notice = document.createElement("p");
      notice.className = "failed";
      notice.textContent = "This browser has no WebGL: the model can't be shown.";
      canvas.replaceWith(notice);
    }
    by.addEventListener("change", fill);
    step.addEventListener("input", arrange);
    apart.addEventListener("input", arrange);
    canvas.addEventListener("keydown", press);
    canvas.addEventListener("pointermove", point);
    canvas.addEventListener("pointerleave", () => { tip.hidden = true; });
    new ResizeObserver(later).observe(canvas);
    new IntersectionObserver((found) => {
      seen = found.some((one) => one.isIntersecting);
      if (seen) later();
    }, { rootMargin: "200px" }).observe(figure);
    fill();

    // Show the box of the selected agent.
    function fill() {
      const option = by.selectedOptions[0];
      const box = data.boxes[Number(by.value)];
      figure.querySelector(".total").textContent = option.dataset.total;
      figure.querySelector(".summary").textContent = option.dataset.summary;
      canvas.setAttribute("aria-label", `${figure.querySelector("b").textContent}, packed by ${option.textContent}: ${option.dataset.summary}. Drag, or use the arrow keys, to rotate it.`);
      step.max = box.items.length; // first, since it bounds the value
      step.value = box.items.length;
      view = null;
      arrange();
    }

    function build() {
      view = BoxScene.build(data.boxes[Number(by.value)], data.shapes, (item) => item.colors[coloring.value]);
      if (!camera) ({ camera, controls } = BoxScene.look(view.size, canvas, later));
    }

    // Show the items that the two sliders select.
    function arrange() {
      step.nextElementSibling.textContent = `${step.value} of ${step.max}`;
      apart.nextElementSibling.textContent = `${apart.value}%`;
      later();
    }

    function later() {
      if (waiting || !seen) return;
      waiting = true;
      requestAnimationFrame(() => {
        waiting = false;
        draw();
      });
    }

    function draw() {
      if (!BoxScene.isPossible) return;
      if (!view) build();
      view.items.forEach(({ mesh }, n) => {
        mesh.visible = n < Number(step.value);
        BoxScene.glaze(mesh, marked !== null && !marked.has(`${by.value}:${n}`));
      });
      BoxScene.apart(view, camera, Number(apart.value) / PERCENT);
      BoxScene.draw(view, camera, canvas);
    }

    function press(event) {
      if (!camera || !BoxScene.turn(event.key, camera, controls)) return;
      event.preventDefault();
      later();
    }

    function point(event) {
      if (!view || event.buttons) return;
      const item = BoxScene.itemAt(event, view, camera, canvas);
      tip.hidden = !item;
      if (item) tip.textContent = `${item.name}: ${(PERCENT * item.share).toFixed(1)}% ${models.dataset.share}`;
    }
  }
})();
