// The meshes of a GLB file in a canvas: positions, colours and triangles, nothing else of the format.
(() => {
  const section = document.getElementById("scene"), canvas = section.querySelector("canvas");
  const select = section.querySelector("select"), kinds = section.querySelector(".controls span");
  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) {
    canvas.replaceWith("This browser has no WebGL 2, which the scene needs.");
    return;
  }
  const bytes = Uint8Array.from(atob(section.querySelector("script").textContent), (c) => c.charCodeAt(0));
  const view = new DataView(bytes.buffer), length = view.getUint32(12, true);
  const file = JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + length)));
  const binary = 28 + length;

  function data(number) { // of an accessor without gaps
    const accessor = file.accessors[number], buffer = file.bufferViews[accessor.bufferView];
    const start = binary + (buffer.byteOffset || 0) + (accessor.byteOffset || 0);
    const Kind = { 5121: Uint8Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array }[accessor.componentType];
    const width = { SCALAR: 1, VEC3: 3, VEC4: 4 }[accessor.type];
    return new Kind(bytes.slice(start, start + accessor.count * width * Kind.BYTES_PER_ELEMENT).buffer);
  }

  const program = gl.createProgram();
  for (const [kind, text] of [
    [gl.VERTEX_SHADER, `#version 300 es
      uniform mat3 turn; uniform vec3 centre, lens; // lens: 1 / radius, zoom, width / height
      in vec3 position; in vec4 colour; out vec3 place; out vec4 paint;
      void main() { // the eye is 4 radii away, and sees what is 2 to 6 away
        place = turn * (position - centre) * lens.x; paint = colour;
        float depth = 4.0 - place.z;
        gl_Position = vec4(3.8 * lens.y * place.xy * min(vec2(1.0 / lens.z, lens.z), 1.0), 2.0 * depth - 6.0, depth);
      }`],
    [gl.FRAGMENT_SHADER, `#version 300 es
      precision highp float; in vec3 place; in vec4 paint; out vec4 found;
      void main() {
        vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
        float light = 0.4 + 0.6 * max(dot(normal, normalize(vec3(-0.35, 0.45, 0.82))), 0.0);
        found = vec4(paint.rgb * light * paint.a, paint.a);
      }`]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  gl.useProgram(program);
  gl.enable(gl.DEPTH_TEST);

  const boxes = {}; // of each state: lower and upper corner
  const meshes = file.meshes.map((mesh) => {
    const { attributes, indices } = mesh.primitives[0], vao = gl.createVertexArray();
    const [state, kind] = mesh.name.split("|"), corners = data(indices), points = data(attributes.POSITION);
    const [low, high] = boxes[state] ??= [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    points.forEach((x, i) => { low[i % 3] = Math.min(low[i % 3], x); high[i % 3] = Math.max(high[i % 3], x); });
    gl.bindVertexArray(vao);
    for (const [name, array, width, type] of [
      ["position", points, 3, gl.FLOAT], ["colour", data(attributes.COLOR_0), 4, gl.UNSIGNED_BYTE]]) {
      const place = gl.getAttribLocation(program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, width, type, true, 0, 0);
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    return { state, kind, vao, count: corners.length, type: file.accessors[indices].componentType };
  });

  for (const state of new Set(meshes.map((mesh) => mesh.state))) select.add(new Option(state, state));
  const ticks = [...new Set(meshes.map((mesh) => mesh.kind))].map((kind, i) => {
    const label = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox"; box.checked = i === 0; box.value = kind;
    label.append(box, ` ${kind}`);
    kinds.append(label);
    box.addEventListener("change", draw);
    return box;
  });
  select.hidden = select.options.length < 2;
  kinds.hidden = ticks.length < 2;
  select.addEventListener("change", draw);

  let yaw, pitch, zoom;
  function reset() { [yaw, pitch, zoom] = [-0.52, 0.31, 1]; draw(); }

  function draw() {
    canvas.width = canvas.clientWidth * devicePixelRatio;
    canvas.height = canvas.clientHeight * devicePixelRatio;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const [s, c, t, d] = [Math.sin(yaw), Math.cos(yaw), Math.sin(pitch), Math.cos(pitch)];
    const [low, high] = boxes[select.value], radius = Math.hypot(...low.map((x, i) => high[i] - x)) / 2;
    const uniform = (name) => gl.getUniformLocation(program, name);
    gl.uniformMatrix3fv(uniform("turn"), false, [c, s * t, -s * d, 0, d, t, s, -c * t, c * d]);
    gl.uniform3fv(uniform("centre"), low.map((x, i) => (x + high[i]) / 2));
    gl.uniform3f(uniform("lens"), 1 / radius, zoom, canvas.width / canvas.height);
    const shown = ticks.filter((box) => box.checked).map((box) => box.value);
    for (const mesh of meshes) {
      if (mesh.state !== select.value || !shown.includes(mesh.kind)) continue;
      gl.bindVertexArray(mesh.vao);
      gl.drawElements(gl.TRIANGLES, mesh.count, mesh.type, 0);
    }
  }

  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    yaw += event.movementX * 0.008;
    pitch = Math.max(-1.57, Math.min(1.57, pitch + event.movementY * 0.008));
    draw();
  });
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas) return; // the wheel scrolls the page until the scene is clicked
    event.preventDefault();
    zoom = Math.max(0.2, Math.min(20, zoom * Math.exp(-event.deltaY * 0.001)));
    draw();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const [x, y] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] || [0, 0];
    if (!x && !y) return;
    event.preventDefault();
    yaw += 0.1 * x;
    pitch = Math.max(-1.57, Math.min(1.57, pitch + 0.1 * y));
    draw();
  });
  canvas.addEventListener("dblclick", reset);
  addEventListener("resize", draw);
  reset();
})();
