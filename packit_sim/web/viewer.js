// The cards of a report: a box each, drawn when it changes.
"use strict";
(() => {
  const models = document.getElementById("models");
  const data = JSON.parse(models.textContent);
  const FAR = 0.7; // how much farther the camera goes, and
  const DOWN = 0.4; // how many heights all goes down, while items are moved apart by their own distance
  const PERCENT = 100;

  const cards = [...document.querySelectorAll(".card")].map((figure) => new Card(figure));
  const coloring = document.getElementById("coloring");
  const ramp = document.getElementById("ramp");
  coloring.addEventListener("change", () => {
    const ends = { order: ["first", "last"], share: ["0%", "the largest share"] }[coloring.value];
    ramp.hidden = !ends;
    if (ends) [ramp.firstElementChild.textContent, ramp.lastElementChild.textContent] = ends;
    cards.forEach((card) => card.paint());
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => cards.forEach((card) => card.draw()));
  addEventListener("beforeprint", () => cards.forEach((card) => card.draw()));

  function Card(figure) {
    const canvas = figure.querySelector("canvas");
    const by = figure.querySelector("select");
    const step = figure.querySelector(".step");
    const apart = figure.querySelector(".apart");
    const tip = figure.querySelector(".tip");
    let view, camera, controls;
    let seen = false;
    let waiting = false;

    this.draw = draw;
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
      const share = Number(apart.value) / PERCENT;
      const [x, y, z] = view.size;
      const middle = new THREE.Vector3(x / 2, y / 2, 0);
      view.items.forEach(({ mesh }, n) => {
        mesh.visible = n < Number(step.value);
        mesh.position.copy(mesh.userData.home).sub(middle).multiplyScalar(share).add(mesh.userData.home);
      });
      view.scene.position.z = -DOWN * share * z;
      camera.zoom = 1 / (1 + FAR * share);
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
