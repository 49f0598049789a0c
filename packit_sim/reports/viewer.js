// Interactive boxes: one WebGL context draws them all, each onto a separate canvas, when it changes.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("models").textContent);
  const FOV = 28, AZIMUTH = (62 * Math.PI) / 180, ELEVATION = (24 * Math.PI) / 180;
  const CREASE = (35 * Math.PI) / 180;
  const LATTICE = 65535;
  const TURN = Math.PI / 24;
  const PIXELS = 2; // the most device pixels per CSS pixel
  const FAR = 0.7; // how much farther the camera goes, and
  const DOWN = 0.4; // how many heights all goes down, while items are moved apart by their own distance
  const PERCENT = 100;

  const renderer = start();
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

  function start() {
    try {
      const webgl = new THREE.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
      webgl.shadowMap.enabled = true;
      webgl.shadowMap.type = THREE.PCFShadowMap;
      return webgl;
    } catch {
      return null;
    }
  }

  function bytes(text) {
    return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  }

  function geometry(shape) {
    if (!shape.geometry) {
      const lattice = new Uint16Array(bytes(shape.vertices));
      const positions = Float32Array.from(lattice, (n, i) => (n / LATTICE - 0.5) * shape.extents[i % 3]);
      const plain = new THREE.BufferGeometry();
      plain.setAttribute("position", new THREE.BufferAttribute(positions, 3));
      plain.setIndex(new THREE.BufferAttribute(new Uint32Array(bytes(shape.faces)), 1));
      shape.geometry = THREE.toCreasedNormals(plain, CREASE);
    }
    return shape.geometry;
  }

  function Card(figure) {
    const canvas = figure.querySelector("canvas");
    const by = figure.querySelector("select");
    const step = figure.querySelector(".step");
    const apart = figure.querySelector(".apart");
    const tip = figure.querySelector(".tip");
    let scene, camera, controls, items, middle, height, edges, floor;
    let seen = false;
    let waiting = false;

    this.draw = draw;
    this.paint = () => {
      if (items) items.forEach((item) => item.mesh.material.color.set(item.colors[coloring.value]));
      later();
    };
    if (!renderer) {
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
      items = null;
      arrange();
    }

    function build() {
      const box = data.boxes[Number(by.value)];
      const [x, y, z] = box.size;
      middle = new THREE.Vector3(x / 2, y / 2, 0);
      height = z;
      scene = new THREE.Scene();
      scene.add(new THREE.HemisphereLight(0xffffff, 0xa39b90, 1.5));
      const sun = new THREE.DirectionalLight(0xffffff, 2.5);
      const far = Math.hypot(x, y, z);
      sun.position.set(x / 2 + 0.9 * far, y / 2 + 0.45 * far, z + 1.3 * far);
      sun.target.position.set(x / 2, y / 2, z / 2);
      sun.castShadow = true;
      sun.shadow.mapSize.set(1024, 1024);
      sun.shadow.bias = -0.0005;
      sun.shadow.normalBias = 0.004;
      Object.assign(sun.shadow.camera, { left: -far, right: far, top: far, bottom: -far, near: 0.01, far: 5 * far });
      scene.add(sun, sun.target);
      edges = new THREE.LineSegments(new THREE.EdgesGeometry(new THREE.BoxGeometry(x, y, z)), new THREE.LineBasicMaterial());
      edges.position.set(x / 2, y / 2, z / 2);
      floor = new THREE.Mesh(new THREE.PlaneGeometry(x, y), new THREE.MeshLambertMaterial());
      floor.position.set(x / 2, y / 2, -0.001);
      floor.receiveShadow = true;
      scene.add(edges, floor);
      items = box.items.map((item) => {
        const mesh = new THREE.Mesh(geometry(data.shapes[item.shape]), new THREE.MeshLambertMaterial({ side: 2, color: item.colors[coloring.value] }));
        mesh.castShadow = mesh.receiveShadow = true;
        const pose = new THREE.Matrix4().set(...item.pose, 0, 0, 0, 1);
        pose.decompose(mesh.position, mesh.quaternion, mesh.scale);
        mesh.userData = { ...item, home: mesh.position.clone() };
        scene.add(mesh);
        return { ...item, mesh };
      });
      if (!camera) {
        camera = new THREE.PerspectiveCamera(FOV, 1, 0.01, 100);
        camera.up.set(0, 0, 1);
        const toward = new THREE.Vector3(
          Math.cos(ELEVATION) * Math.cos(AZIMUTH), Math.cos(ELEVATION) * Math.sin(AZIMUTH), Math.sin(ELEVATION));
        const center = new THREE.Vector3(x / 2, y / 2, 0.46 * z);
        camera.position.copy(center).addScaledVector(toward, (0.49 * far) / Math.sin((FOV * Math.PI) / 360));
        controls = new THREE.OrbitControls(camera, canvas);
        controls.target.copy(center);
        controls.enablePan = controls.enableZoom = false;
        canvas.style.touchAction = "pan-y";
        controls.addEventListener("change", later);
        canvas.addEventListener("focus", () => { controls.enableZoom = true; });
        canvas.addEventListener("blur", () => { controls.enableZoom = false; });
        controls.update();
      }
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
      if (!renderer) return;
      if (!items) build();
      const share = Number(apart.value) / PERCENT;
      items.forEach(({ mesh }, n) => {
        mesh.visible = n < Number(step.value);
        mesh.position.copy(mesh.userData.home).sub(middle).multiplyScalar(share).add(mesh.userData.home);
      });
      const style = getComputedStyle(document.documentElement);
      edges.material.color.set(style.getPropertyValue("--edge").trim());
      floor.material.color.set(style.getPropertyValue("--floor").trim());
      const scale = Math.min(devicePixelRatio || 1, PIXELS);
      const width = Math.max(1, Math.round(canvas.clientWidth * scale));
      const rows = Math.max(1, Math.round(canvas.clientHeight * scale));
      if (canvas.width !== width || canvas.height !== rows) [canvas.width, canvas.height] = [width, rows];
      renderer.setSize(width, rows, false);
      camera.aspect = width / rows;
      scene.position.z = -DOWN * share * height;
      camera.zoom = 1 / (1 + FAR * share);
      camera.updateProjectionMatrix();
      renderer.render(scene, camera);
      const context = canvas.getContext("2d");
      context.clearRect(0, 0, width, rows);
      context.drawImage(renderer.domElement, 0, 0);
      canvas.dataset.drawn = String(Number(canvas.dataset.drawn || 0) + 1);
    }

    function press(event) {
      const turns = { ArrowLeft: [-TURN, 0], ArrowRight: [TURN, 0], ArrowUp: [0, TURN], ArrowDown: [0, -TURN] };
      if (!camera) return;
      if (turns[event.key]) {
        const [around, up] = turns[event.key];
        const offset = camera.position.clone().sub(controls.target);
        const far = offset.length();
        const azimuth = Math.atan2(offset.y, offset.x) - around;
        const elevation = Math.max(-1.5, Math.min(1.5, Math.asin(offset.z / far) + up));
        offset.set(Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation));
        camera.position.copy(controls.target).addScaledVector(offset, far);
      } else if (event.key === "+" || event.key === "-") {
        camera.position.sub(controls.target).multiplyScalar(event.key === "+" ? 0.9 : 1 / 0.9).add(controls.target);
      } else {
        return;
      }
      event.preventDefault();
      controls.update();
      later();
    }

    function point(event) {
      if (!items || event.buttons) return;
      const frame = canvas.getBoundingClientRect();
      const at = new THREE.Vector2((2 * (event.clientX - frame.x)) / frame.width - 1, 1 - (2 * (event.clientY - frame.y)) / frame.height);
      const ray = new THREE.Raycaster();
      ray.setFromCamera(at, camera);
      const [hit] = ray.intersectObjects(items.map(({ mesh }) => mesh).filter((mesh) => mesh.visible), false);
      tip.hidden = !hit;
      if (hit) tip.textContent = `${hit.object.userData.name}: ${(PERCENT * hit.object.userData.share).toFixed(1)}% of the reward`;
    }
  }
})();
