// A small WebGL 2 view of a deformed model; where there is none, the page's still picture stays.
"use strict";
(function () {
  const VERTEX = `#version 300 es
    in vec3 point; in vec3 displacement; in float value;
    uniform mat4 camera; uniform float amount; uniform float most; uniform float nearer;
    out vec3 place; out float field; out float rest;
    void main() {
      place = point + amount * displacement;
      rest = point.y; field = value < 0.0 ? length(displacement) * amount / most : value;
      gl_Position = camera * vec4(place, 1.0);
      gl_Position.z -= nearer * gl_Position.w;
    }`;
  const FRAGMENT = `#version 300 es
    precision highp float;
    in vec3 place; in float field; in float rest;
    uniform sampler2D colours; uniform vec4 plain; uniform bool coloured; uniform bool lit; uniform bool opened;
    uniform float height; uniform vec3 toEye;
    out vec4 colour;
    void main() {
      if (opened && rest < height) discard;
      vec3 base = coloured ? texture(colours, vec2(clamp(field, 0.01, 0.99), 0.5)).rgb : plain.rgb;
      if (lit) {
        vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
        base *= 0.55 + 0.45 * abs(dot(normal, toEye));
      }
      colour = vec4(base, plain.a);
    }`;

  function bytes(text) { return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer; }

  function program(gl) {
    const made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text); gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
    return made;
  }

  function load(gl, own, part, scene) {
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    for (const [name, text, step] of [["point", part.points, scene.step_mm],
                                      ["displacement", part.displacement, scene.displacement_step_mm]]) {
      const whole = new Int16Array(bytes(text)), values = new Float32Array(whole.length);
      for (let k = 0; k < whole.length; k++) values[k] = whole[k] * step;
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      const place = gl.getAttribLocation(own, name);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
    }
    if (part.values) {
      const shares = Float32Array.from(new Uint16Array(bytes(part.values)), (each) => each / 65535);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, shares, gl.STATIC_DRAW);
      const place = gl.getAttribLocation(own, "value");
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 1, gl.FLOAT, false, 0, 0);
    }
    const kept = { name: part.name, coloured: part.coloured, array };
    for (const name of ["triangles", "edges"]) {
      const numbers = new Uint32Array(bytes(part[name])), buffer = gl.createBuffer();
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, numbers, gl.STATIC_DRAW);
      kept[name] = { buffer, count: numbers.length };
    }
    gl.bindVertexArray(null);
    return kept;
  }

  // Column-major matrix of an orthographic camera: turned by `turn` about z, tilted, scaled to the canvas.
  function camera(look, radius, ratio) {
    const [ct, st, cp, sp] = [Math.cos(look.turn), Math.sin(look.turn), Math.cos(look.tilt), Math.sin(look.tilt)];
    const right = [ct, st, 0], up = [-st * sp, ct * sp, cp], eye = [st * cp, -ct * cp, sp];
    const size = look.zoom / radius, sx = ratio > 1 ? size / ratio : size, sy = ratio > 1 ? size : size * ratio;
    const depth = -0.3 / radius;
    return { matrix: new Float32Array([right[0] * sx, up[0] * sy, eye[0] * depth, 0, right[1] * sx, up[1] * sy,
      eye[1] * depth, 0, right[2] * sx, up[2] * sy, eye[2] * depth, 0, 0, 0, 0, 1]), eye };
  }

  function start(box) {
    const scene = JSON.parse(box.querySelector("script[type='application/json']").textContent);
    const canvas = box.querySelector("canvas"), gl = canvas.getContext("webgl2", { antialias: true });
    if (!gl) return;
    const own = program(gl), at = (name) => gl.getUniformLocation(own, name);
    const parts = scene.parts.map((part) => load(gl, own, part, scene));
    gl.useProgram(own);
    gl.vertexAttrib1f(gl.getAttribLocation(own, "value"), -1);  // parts without values show their displacement
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    const colours = new Uint8Array(bytes(scene.colours));
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, colours.length / 3, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, colours);
    for (const [key, value] of [[gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) gl.texParameteri(gl.TEXTURE_2D, key, value);
    gl.enable(gl.DEPTH_TEST);
    const first = { turn: 0.6, tilt: 0.55, zoom: 1.15 }, look = { ...first };
    const chosen = (name) => box.querySelector(`input[name='${name}']`);
    const ticked = (name) => Boolean(chosen(name) && chosen(name).checked);
    let asked = false;

    function draw() {
      asked = false;
      const scale = Math.min(window.devicePixelRatio || 1, 2);
      const [width, height] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
      if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
      gl.viewport(0, 0, width, height);
      gl.clearColor(1, 1, 1, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      const seen = camera(look, scene.radius_mm, width / Math.max(height, 1));
      const opened = ticked("opened");
      gl.uniformMatrix4fv(at("camera"), false, seen.matrix);
      gl.uniform3fv(at("toEye"), seen.eye);
      gl.uniform1f(at("amount"), chosen("amount").value / 100);
      gl.uniform1f(at("most"), scene.field_mm || 1);
      gl.uniform1f(at("height"), -scene.origin_mm[1]);
      for (const part of parts) {
        if (part.name === "section" && !opened) continue;
        if (part.name === "probe" && !ticked("probe")) continue;
        gl.bindVertexArray(part.array);
        gl.uniform1i(at("opened"), opened && part.name !== "section");
        gl.uniform1i(at("coloured"), part.coloured);
        gl.uniform1i(at("lit"), true);
        gl.uniform1f(at("nearer"), 0);
        gl.uniform4fv(at("plain"), part.name === "probe" ? [0.45, 0.5, 0.55, 1] : [0.92, 0.88, 0.78, 1]);
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, part.triangles.buffer);
        gl.drawElements(gl.TRIANGLES, part.triangles.count, gl.UNSIGNED_INT, 0);
        if (ticked("mesh")) {
          gl.uniform1i(at("coloured"), false);
          gl.uniform1i(at("lit"), false);
          gl.uniform1f(at("nearer"), 0.0015);
          gl.uniform4fv(at("plain"), [0.15, 0.2, 0.25, 1]);
          gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, part.edges.buffer);
          gl.drawElements(gl.LINES, part.edges.count, gl.UNSIGNED_INT, 0);
        }
      }
    }
    function ask() { if (!asked) { asked = true; requestAnimationFrame(draw); } }

    function turn(across, down) {
      look.turn -= across;
      look.tilt = Math.max(-1.55, Math.min(1.55, look.tilt + down));
      ask();
    }
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) turn(0.008 * event.movementX, 0.008 * event.movementY);
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      look.zoom = Math.max(0.5, Math.min(12, look.zoom * Math.exp(-0.001 * event.deltaY)));
      ask();
    }, { passive: false });
    canvas.addEventListener("dblclick", () => { Object.assign(look, first); ask(); });
    canvas.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
      if (steps) { event.preventDefault(); turn(...steps); }
      if (event.key === "+" || event.key === "-") { look.zoom *= event.key === "+" ? 1.15 : 1 / 1.15; ask(); }
    });
    box.querySelectorAll("input").forEach((each) => each.addEventListener("input", ask));
    new ResizeObserver(ask).observe(canvas);
    box.classList.add("live");
    draw();
  }

  document.querySelectorAll(".view3d").forEach((box) => {
    try { start(box); } catch (error) { box.classList.remove("live"); console.warn("no 3-D view:", error); }
  });
})();
