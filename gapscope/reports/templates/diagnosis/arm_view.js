/* The arm in 3D: recorded and simulated, moving, with the gap coloured on its joints. Needs three-parts.min.js. */
"use strict";

const ArmView = (() => {
  const look = { recorded: { name: "ink", opacity: 1 }, nominal: { name: "nominal", opacity: 0.45 }, corrected: { name: "corrected", opacity: 0.45 } };
  const variable = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const floats = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const whole = (text) => new Uint16Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);

  /* One arm: a group for each joint, turned by the joint's position. */
  function buildArm(data, kind) {
    const root = new THREE.Group();
    const groups = data.joints.map(() => new THREE.Group());
    const rests = data.joints.map((joint, k) => {
      (joint.parent < 0 ? root : groups[joint.parent]).add(groups[k]);
      return { place: new THREE.Vector3(...joint.place), turn: new THREE.Quaternion(...joint.turn), axis: new THREE.Vector3(...joint.axis) };
    });
    const material = () => new THREE.MeshStandardMaterial({
      color: variable(look[kind].name), roughness: 0.7, side: THREE.DoubleSide,
      transparent: look[kind].opacity < 1, opacity: look[kind].opacity, depthWrite: look[kind].opacity === 1,
    });
    const skins = data.joints.map(material);
    const base = material();
    data.hulls.forEach((hull) => {
      const shape = new THREE.BufferGeometry();
      shape.setAttribute("position", new THREE.BufferAttribute(floats(hull.vertices), 3));
      shape.setIndex(new THREE.BufferAttribute(whole(hull.faces), 1));
      const flat = shape.toNonIndexed();
      flat.computeVertexNormals();
      (hull.joint < 0 ? root : groups[hull.joint]).add(new THREE.Mesh(flat, hull.joint < 0 ? base : skins[hull.joint]));
    });
    function move(q) {
      const turned = new THREE.Quaternion();
      data.joints.forEach((joint, k) => {
        const value = q(joint.column), rest = rests[k];
        groups[k].position.copy(rest.place);
        groups[k].quaternion.copy(rest.turn);
        if (joint.slides) groups[k].position.add(rest.axis.clone().applyQuaternion(rest.turn).multiplyScalar(value));
        else groups[k].quaternion.multiply(turned.setFromAxisAngle(rest.axis, value));
      });
    }
    return { root, move, skins };
  }

  /* From the arm's own colour to the colour of the gap, as the gap of a joint rises to its torque's deviation. */
  function paint(arm, data, gap) {
    const calm = new THREE.Color(variable("soft")), hot = new THREE.Color(variable("nominal"));
    data.joints.forEach((joint, k) => arm.skins[k].color.copy(calm).lerp(hot, Math.min(1, gap(joint.column))));
  }

  return function (element, data, onTime) {
    const t = floats(data.motion.t), n = data.joints.length;
    const motions = Object.fromEntries(Object.entries(data.motion.arms).map(([name, text]) => [name, floats(text)]));
    const gaps = { before: floats(data.motion.gaps.before), after: floats(data.motion.gaps.after) };
    const scene = new THREE.Scene();
    const arms = Object.fromEntries(Object.keys(motions).map((name) => [name, buildArm(data, name)]));
    const world = new THREE.Group();
    world.rotation.x = -Math.PI / 2; // z of the robot points up
    Object.values(arms).forEach((arm) => world.add(arm.root));
    scene.add(world, new THREE.AmbientLight(0xffffff, 1.6));
    const sun = new THREE.DirectionalLight(0xffffff, 2.2);
    sun.position.set(2, 4, 3);
    scene.add(sun, new THREE.GridHelper(2 * data.reach, 10, variable("soft"), variable("line")));
    const camera = new THREE.PerspectiveCamera(40, 1, 0.01, 50);
    camera.position.set(1.1, 0.9, 1.3).multiplyScalar(data.reach);
    const renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
    renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
    element.append(renderer.domElement);
    const controls = new THREE.OrbitControls(camera, renderer.domElement);
    controls.target.set(0, 0.4 * data.reach, 0);
    controls.enableZoom = false; // the wheel scrolls the page
    let frame = 0, stage = "before";

    function draw() {
      renderer.render(scene, camera);
    }
    function show(k) {
      frame = Math.max(0, Math.min(t.length - 1, k));
      Object.entries(arms).forEach(([name, arm]) => arm.move((column) => motions[name][frame * n + column]));
      paint(arms.recorded, data, (column) => gaps[stage][frame * n + column]);
      draw();
      onTime(t[frame]);
    }
    function resize() {
      const width = element.clientWidth, height = element.clientHeight;
      renderer.setSize(width, height);
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
      controls.update();
      draw();
    }
    controls.addEventListener("change", draw);
    new ResizeObserver(resize).observe(element);
    show(0);
    return {
      frames: t.length,
      show,
      frameAt: (time) => t.findIndex((value) => value >= time),
      timeAt: (k) => t[k],
      setStage: (name) => { stage = name; show(frame); },
      setVisible: (name, on) => { if (arms[name]) arms[name].root.visible = on; draw(); },
      names: Object.keys(arms),
      repaint: () => show(frame),
    };
  };
})();
