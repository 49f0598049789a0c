// A box and its items as a scene of three.js, drawn by the one WebGL context of a page.
"use strict";
const BoxScene = (() => {
  const FOV = 28, AZIMUTH = (62 * Math.PI) / 180, ELEVATION = (24 * Math.PI) / 180;
  const CREASE = (35 * Math.PI) / 180;
  const LATTICE = 65535;
  const TURN = Math.PI / 24;
  const GLASS = 0.1; // opacity of items that are not marked
  const PIXELS = 2; // the most device pixels per CSS pixel
  const FAR = 0.7; // how much farther the camera goes, and
  const DOWN = 0.4; // how many heights all goes down, while items are moved apart by their own distance

  const renderer = start();

  function start() {
    try {
      const webgl = new THREE.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
      webgl.shadowMap.enabled = webgl.localClippingEnabled = true;
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

  // Create the scene of a box; each item becomes a mesh whose `userData` has the item and its home.
  function build(box, shapes, color) {
    const [x, y, z] = box.size;
    const scene = new THREE.Scene();
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
    const lines = new THREE.BufferGeometry();
    lines.setAttribute("position", new THREE.BufferAttribute(Float32Array.from(box.outline), 3));
    const isBox = box.outline.length === 0;
    const edges = new THREE.LineSegments(isBox ? new THREE.EdgesGeometry(new THREE.BoxGeometry(x, y, z)) : lines, new THREE.LineBasicMaterial());
    if (isBox) edges.position.set(x / 2, y / 2, z / 2);
    const floor = new THREE.Mesh(new THREE.PlaneGeometry(x, y), new THREE.MeshLambertMaterial());
    floor.position.set(x / 2, y / 2, -0.001);
    floor.receiveShadow = true;
    floor.visible = isBox;
    scene.add(edges, floor);
    const items = box.items.map((item) => {
      const mesh = new THREE.Mesh(geometry(shapes[item.shape]), new THREE.MeshLambertMaterial({ side: 2, color: color(item) }));
      mesh.castShadow = mesh.receiveShadow = true;
      const pose = new THREE.Matrix4().set(...item.pose, 0, 0, 0, 1);
      pose.decompose(mesh.position, mesh.quaternion, mesh.scale);
      mesh.userData = { ...item, home: mesh.position.clone() };
      scene.add(mesh);
      return { ...item, mesh };
    });
    return { size: box.size, scene, edges, floor, items };
  }

  // Make an item look like glass, or solid again.
  function glaze(mesh, glass) {
    if (mesh.material.transparent === glass) return;
    Object.assign(mesh.material, { transparent: glass, opacity: glass ? GLASS : 1, depthWrite: !glass, needsUpdate: true });
    mesh.castShadow = !glass;
  }

  // Move the items of a box apart by a share of their distance from the middle of its floor.
  function apart(view, camera, share) {
    const [x, y, z] = view.size;
    const middle = new THREE.Vector3(x / 2, y / 2, 0);
    for (const { mesh } of view.items) {
      mesh.position.copy(mesh.userData.home).sub(middle).multiplyScalar(share).add(mesh.userData.home);
    }
    view.scene.position.z = -DOWN * share * z;
    camera.zoom = 1 / (1 + FAR * share);
  }

  // Cut off a share of a box, from the side of the camera's first place.
  function cut(view, share) {
    const plane = { normal: new THREE.Vector3(0, -1, 0), constant: (1 - share) * view.size[1] };
    for (const { mesh } of view.items) mesh.material.clippingPlanes = share > 0 ? [plane] : [];
  }

  // Create a camera that looks at a box, with controls on its canvas.
  function look([x, y, z], canvas, changed) {
    const camera = new THREE.PerspectiveCamera(FOV, 1, 0.01, 100);
    camera.up.set(0, 0, 1);
    const toward = new THREE.Vector3(
      Math.cos(ELEVATION) * Math.cos(AZIMUTH), Math.cos(ELEVATION) * Math.sin(AZIMUTH), Math.sin(ELEVATION));
    const center = new THREE.Vector3(x / 2, y / 2, 0.46 * z);
    camera.position.copy(center).addScaledVector(toward, (0.49 * Math.hypot(x, y, z)) / Math.sin((FOV * Math.PI) / 360));
    const controls = new THREE.OrbitControls(camera, canvas);
    controls.target.copy(center);
    controls.enablePan = controls.enableZoom = false;
    canvas.style.touchAction = "pan-y";
    controls.addEventListener("change", changed);
    canvas.addEventListener("focus", () => { controls.enableZoom = true; });
    canvas.addEventListener("blur", () => { controls.enableZoom = false; });
    controls.update();
    return { camera, controls };
  }

  // Draw a scene onto a canvas, in the colours of the page.
  function draw(view, camera, canvas) {
    const style = getComputedStyle(document.documentElement);
    view.edges.material.color.set(style.getPropertyValue("--edge").trim());
    view.floor.material.color.set(style.getPropertyValue("--floor").trim());
    const scale = Math.min(devicePixelRatio || 1, PIXELS);
    const width = Math.max(1, Math.round(canvas.clientWidth * scale));
    const rows = Math.max(1, Math.round(canvas.clientHeight * scale));
    if (canvas.width !== width || canvas.height !== rows) [canvas.width, canvas.height] = [width, rows];
    renderer.setSize(width, rows, false);
    camera.aspect = width / rows;
    camera.updateProjectionMatrix();
    renderer.render(view.scene, camera);
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, width, rows);
    context.drawImage(renderer.domElement, 0, 0);
    canvas.dataset.drawn = String(Number(canvas.dataset.drawn || 0) + 1);
  }

  // Turn a camera by a key; return whether the key does so.
  function turn(key, camera, controls) {
    const turns = { ArrowLeft: [-TURN, 0], ArrowRight: [TURN, 0], ArrowUp: [0, TURN], ArrowDown: [0, -TURN] };
    if (turns[key]) {
      const [around, up] = turns[key];
      const offset = camera.position.clone().sub(controls.target);
      const far = offset.length();
      const azimuth = Math.atan2(offset.y, offset.x) - around;
      const elevation = Math.max(-1.5, Math.min(1.5, Math.asin(offset.z / far) + up));
      offset.set(Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation));
      camera.position.copy(controls.target).addScaledVector(offset, far);
    } else if (key === "+" || key === "-") {
      camera.position.sub(controls.target).multiplyScalar(key === "+" ? 0.9 : 1 / 0.9).add(controls.target);
    } else {
      return false;
    }
    controls.update();
    return true;
  }

  // Return the visible item at the pointer, if there is one.
  function itemAt(event, view, camera, canvas) {
    const frame = canvas.getBoundingClientRect();
    const at = new THREE.Vector2((2 * (event.clientX - frame.x)) / frame.width - 1, 1 - (2 * (event.clientY - frame.y)) / frame.height);
    const ray = new THREE.Raycaster();
    ray.setFromCamera(at, camera);
    const visible = view.items.filter(({ mesh }) => mesh.visible);
    const hits = ray.intersectObjects(visible.map(({ mesh }) => mesh), false);
    const isLeft = ({ normal, constant }, point) => normal.dot(point) + constant >= 0;
    const hit = hits.find(({ object, point }) => (object.material.clippingPlanes || []).every((plane) => isLeft(plane, point)));
    return hit && visible.find(({ mesh }) => mesh === hit.object);
  }

  return { isPossible: renderer !== null, build, glaze, apart, cut, look, draw, turn, itemAt };
})();
