// Draws a robot cell in space with WebGL; the scene's format stands in the docstring of this package.
// calibrationScene(element, scene, {words, shown}) returns null without WebGL; `words` replaces the texts in TEXTS, and
// `shown` says of each kind of thing whether it is drawn at first.
(function (root) {
  "use strict";

  var TEXTS = {
    robot: "robot", targets: "targets", frames: "frames", tracker: "tracker", boxes: "boxes", names: "names",
    posture: "configuration", reset: "reset the view", away: "m away",
    hint: "Drag or use the arrow keys to turn; wheel, two fingers, plus and minus to zoom.",
  };
  var COLOURS = {
    robot: [0.70, 0.73, 0.77], joint: [0.45, 0.50, 0.56], tool: [0.25, 0.27, 0.30], target: [0.07, 0.07, 0.07],
    tracker: [0.62, 0.36, 0.00], boxes: [0.55, 0.55, 0.55], floor: [0.86, 0.86, 0.86],
    place: [0.07, 0.07, 0.07],
  };
  var AXES = [[0.78, 0.12, 0.12], [0.10, 0.52, 0.15], [0.12, 0.25, 0.78]];
  var VERTEX = "attribute vec3 at; attribute vec3 normal; uniform mat4 eye; uniform mat4 model; uniform mat3 turn;" +
    "uniform float size; varying vec3 out_of; void main() { gl_Position = eye * model * vec4(at, 1.0);" +
    "out_of = turn * normal; gl_PointSize = size; }";
  var FRAGMENT = "precision mediump float; uniform vec4 colour; uniform float flat_; uniform float round; uniform vec3 look;" +
    "varying vec3 out_of; void main() { float light = 1.0;" +
    "if (round > 0.5 && length(gl_PointCoord - vec2(0.5)) > 0.5) { discard; }" +
    "if (flat_ < 0.5) { vec3 n = normalize(out_of); light = 0.42 + 0.38 * abs(dot(n, normalize(look)))" +
    "+ 0.24 * max(dot(n, vec3(0.27, -0.36, 0.89)), 0.0); } gl_FragColor = vec4(colour.rgb * light, colour.a); }";

  // --- matrices, column by column ---------------------------------------------------------------------------------

  function identity() { return new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]); }

  function ofRows(p) {
    return new Float32Array([p[0], p[4], p[8], 0, p[1], p[5], p[9], 0, p[2], p[6], p[10], 0, p[3], p[7], p[11], 1]);
  }

  function times(a, b) {
    var out = new Float32Array(16), i, j;
    for (j = 0; j < 4; j++) {
      for (i = 0; i < 4; i++) {
        out[4 * j + i] = a[i] * b[4 * j] + a[4 + i] * b[4 * j + 1] + a[8 + i] * b[4 * j + 2] + a[12 + i] * b[4 * j + 3];
      }
    }
    return out;
  }

  function apply(a, p) {
    return [0, 1, 2].map(function (i) { return a[i] * p[0] + a[4 + i] * p[1] + a[8 + i] * p[2] + a[12 + i]; });
  }

  function scaled(a, x, y, z) {
    var out = new Float32Array(a), i;
    for (i = 0; i < 4; i++) { out[i] *= x; out[4 + i] *= y; out[8 + i] *= z; }
    return out;
  }

  function moved(place) { var m = identity(); m.set(place, 12); return m; }

  function spun(angle) {
    var m = identity(), c = Math.cos(angle), s = Math.sin(angle);
    m[0] = c; m[1] = s; m[4] = -s; m[5] = c;
    return m;
  }

  // Inverse transpose of the upper 3 x 3, up to a factor: what turns normals.
  function normals(m) {
    var a = m[0], b = m[1], c = m[2], d = m[4], e = m[5], f = m[6], g = m[8], h = m[9], k = m[10];
    return new Float32Array([e * k - f * h, f * g - d * k, d * h - e * g, c * h - b * k, a * k - c * g, b * g - a * h,
      b * f - c * e, c * d - a * f, a * e - b * d]);
  }

  function minus(a, b) { return [a[0] - b[0], a[1] - b[1], a[2] - b[2]]; }
  function plus(a, b) { return [a[0] + b[0], a[1] + b[1], a[2] + b[2]]; }
  function cross(a, b) { return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]; }
  function length(a) { return Math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); }
  function by(a, k) { return [a[0] * k, a[1] * k, a[2] * k]; }

  // A pose with its origin at `start` and z along `way`.
  function along(start, way) {
    var z = by(way, 1 / (length(way) || 1)), x = cross(Math.abs(z[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], z), y;
    x = by(x, 1 / (length(x) || 1));
    y = cross(z, x);
    return new Float32Array([x[0], x[1], x[2], 0, y[0], y[1], y[2], 0, z[0], z[1], z[2], 0, start[0], start[1], start[2], 1]);
  }

  function looking(eye, to) {
    var z = minus(eye, to), x, y;
    z = by(z, 1 / length(z));
    x = cross([0, 0, 1], z);
    x = by(x, 1 / (length(x) || 1));
    y = cross(z, x);
    return new Float32Array([x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0,
      -(x[0] * eye[0] + x[1] * eye[1] + x[2] * eye[2]), -(y[0] * eye[0] + y[1] * eye[1] + y[2] * eye[2]),
      -(z[0] * eye[0] + z[1] * eye[1] + z[2] * eye[2]), 1]);
  }

  function perspective(fov, aspect, near, far) {
    var f = 1 / Math.tan(fov / 2), m = new Float32Array(16);
    m[0] = f / aspect; m[5] = f; m[10] = (far + near) / (near - far); m[11] = -1; m[14] = 2 * far * near / (near - far);
    return m;
  }

  // --- shapes: positions and normals, triangle by triangle ---------------------------------------------------------

  function triangles(points, faces) {
    var out = [], i, a, b, c, n;
    for (i = 0; i < faces.length; i += 3) {
      a = points[faces[i]]; b = points[faces[i + 1]]; c = points[faces[i + 2]];
      n = cross(minus(b, a), minus(c, a));
      n = by(n, 1 / (length(n) || 1));
      out.push(a[0], a[1], a[2], n[0], n[1], n[2], b[0], b[1], b[2], n[0], n[1], n[2], c[0], c[1], c[2], n[0], n[1], n[2]);
    }
    return new Float32Array(out);
  }

  function cube() {
    var p = [], i;
    for (i = 0; i < 8; i++) { p.push([(i & 1) - 0.5, ((i >> 1) & 1) - 0.5, ((i >> 2) & 1) - 0.5]); }
    return triangles(p, [0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4, 2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5]);
  }

  // What a profile (radius, height, and its normal) sweeps around z.
  function lathe(profile, sides) {
    var out = [], i, k, a, b;
    function corner(row, turn) {
      var t = 2 * Math.PI * turn / sides, c = Math.cos(t), s = Math.sin(t);
      out.push(row[0] * c, row[0] * s, row[1], row[2] * c, row[2] * s, row[3]);
    }
    for (k = 0; k + 1 < profile.length; k += 2) {
      a = profile[k]; b = profile[k + 1];
      for (i = 0; i < sides; i++) {
        corner(a, i); corner(a, i + 1); corner(b, i + 1); corner(a, i); corner(b, i + 1); corner(b, i);
      }
    }
    return new Float32Array(out);
  }

  function cylinder() {
    return lathe([[0, -0.5, 0, -1], [1, -0.5, 0, -1], [1, -0.5, 1, 0], [1, 0.5, 1, 0], [1, 0.5, 0, 1], [0, 0.5, 0, 1]], 28);
  }

  function cone() {  // from its base at z = 0 to its tip at z = 1
    return lathe([[0, 0, 0, -1], [1, 0, 0, -1], [1, 0, 0.7, 0.7], [0, 1, 0.7, 0.7]], 20);
  }

  function sphere() {
    var rows = [], k, s = 10, t;
    function row(i) { t = Math.PI * (i / s - 0.5); return [Math.cos(t), Math.sin(t), Math.cos(t), Math.sin(t)]; }
    for (k = 0; k < s; k++) { rows.push(row(k), row(k + 1)); }
    return lathe(rows, 18);
  }

  function unpacked(text, Kind) {
    var raw = root.atob(text), bytes = new Uint8Array(raw.length), i;
    for (i = 0; i < raw.length; i++) { bytes[i] = raw.charCodeAt(i); }
    return new Kind(bytes.buffer);
  }

  function meshed(mesh) {
    var grid = unpacked(mesh.vertices, Uint16Array), points = [], i;
    for (i = 0; i < grid.length; i += 3) {
      points.push([0, 1, 2].map(function (k) { return mesh.low[k] + mesh.step * grid[i + k]; }));
    }
    return triangles(points, unpacked(mesh.faces, Uint16Array));
  }

  // --- the robot ----------------------------------------------------------------------------------------------------

  // Poses of base, of what each joint carries, and of the flange.
  function kinematics(scene, q) {
    var here = identity(), links = [here], own = 0;
    scene.joints.forEach(function (joint) {
      var at = joint.mimic ? joint.mimic.multiplier * q[joint.mimic.joint] + joint.mimic.offset : q[own++];
      here = times(here, ofRows(joint.pose));
      here = times(here, spun(joint.offset + (joint.prismatic ? 0 : at)));
      if (joint.prismatic) { here = times(here, moved([0, 0, at])); }
      links.push(here);
    });
    return { links: links, flange: times(here, ofRows(scene.flange)) };
  }

  function corners(scene, robot) {
    var all = [[0, 0, 0]];
    robot.links.concat([robot.flange]).forEach(function (m) { all.push([m[12], m[13], m[14]]); });
    Object.keys(scene.targets).forEach(function (name) { all.push(apply(robot.flange, scene.targets[name])); });
    Object.keys(scene.places).forEach(function (name) { all = all.concat(scene.places[name]); });
    return all;
  }

  function bounds(all) {
    var low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    all.forEach(function (p) {
      for (var i = 0; i < 3; i++) { low[i] = Math.min(low[i], p[i]); high[i] = Math.max(high[i], p[i]); }
    });
    return { middle: by(plus(low, high), 0.5), size: length(minus(high, low)) || 1, low: low, high: high };
  }

  // --- the drawing ---------------------------------------------------------------------------------------------------

  function element(kind, style, parent) {
    var one = root.document.createElement(kind);
    one.style.cssText = style;
    parent.appendChild(one);
    return one;
  }

  function calibrationScene(place, scene, options) {
    var words = Object.assign({}, TEXTS, (options || {}).words), gl, program, at, normal, where = {}, parts = {};
    var box = element("div", "display:flex;flex-direction:column;width:100%;height:100%;min-height:0", place);
    var stage = element("div", "position:relative;flex:1;min-height:12rem;overflow:hidden", box);
    var canvas = element("canvas", "display:block;width:100%;height:100%;touch-action:pan-y;cursor:grab", stage);
    var names = element("div", "position:absolute;inset:0;pointer-events:none;font:12px sans-serif;color:#111", stage);
    var bar = element("div", "display:flex;flex-wrap:wrap;gap:.2rem 1rem;align-items:center;padding:.3rem 0;font-size:.85rem", box);
    var fixed = Boolean((options || {}).fixed), shown = Object.assign({}, (options || {}).shown), index = 0, robot, size, home, camera, lines = {}, waiting = false, q, fingers = {}, apart = 0;

    gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) { place.removeChild(box); return null; }
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");

    function compiled(kind, source) {
      var shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) { throw new Error(gl.getShaderInfoLog(shader)); }
      return shader;
    }

    function buffer(data) {
      var one = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, one);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      return { buffer: one, count: data.length / 6 };
    }

    function prepare() {
      program = gl.createProgram();
      gl.attachShader(program, compiled(gl.VERTEX_SHADER, VERTEX));
      gl.attachShader(program, compiled(gl.FRAGMENT_SHADER, FRAGMENT));
      gl.linkProgram(program);
      gl.useProgram(program);
      at = gl.getAttribLocation(program, "at");
      normal = gl.getAttribLocation(program, "normal");
      ["eye", "model", "turn", "size", "colour", "flat_", "round", "look"].forEach(function (name) {
        where[name] = gl.getUniformLocation(program, name);
      });
      gl.enableVertexAttribArray(at);
      gl.enableVertexAttribArray(normal);
      gl.enable(gl.DEPTH_TEST);
      gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
      parts = { box: buffer(cube()), cylinder: buffer(cylinder()), sphere: buffer(sphere()), cone: buffer(cone()) };
      load();
    }

    // A buffer of points, for lines and dots; they have no normals.
    function strip(points) {
      var data = new Float32Array(6 * points.length);
      points.forEach(function (p, i) { data.set([p[0], p[1], p[2], 0, 0, 1], 6 * i); });
      return buffer(data);
    }

    function load() {
      scene.meshes.forEach(function (mesh, i) { forget(parts["mesh" + i]); parts["mesh" + i] = buffer(meshed(mesh)); });
      lined();
    }

    function lined() {
      [].concat(lines.places || [], lines.arrows || [], lines.floor).forEach(forget);
      lines.places = Object.keys(scene.places).map(function (name) { return strip(scene.places[name]); });
      lines.arrows = scene.kinds.map(function (kind) { return strip(shafts(kind.name)); });
      lines.floor = strip(grid());
    }

    function forget(one) {
      if (one) { gl.deleteBuffer(one.buffer); }
    }

    function shafts(kind) {
      var out = [];
      scene.arrows.forEach(function (a) { if (a.kind === kind) { out.push(a.start, plus(a.start, a.vector)); } });
      return out;
    }

    function grid() {
      var out = [], step = Math.pow(10, Math.floor(Math.log10(size / 2))), half = Math.ceil(0.8 * size / step) * step, x;
      if (half / step > 12) { step *= 2; half = Math.ceil(half / step) * step; }
      for (x = -half; x <= half + step / 2; x += step) { out.push([x, -half, 0], [x, half, 0], [-half, x, 0], [half, x, 0]); }
      return out;
    }

    function near(p) { return length(minus(p, home.to)) < 3.5 * size; }

    function frame() {
      var all = corners(scene, kinematics(scene, scene.postures[0].q)), tight = bounds(all), wide;
      size = tight.size;
      home = { to: tight.middle };
      if (scene.tracker && shown.tracker !== false && near(scene.tracker)) { all.push(scene.tracker); }
      scene.boxes.forEach(function (b) { if (near([b.pose[3], b.pose[7], b.pose[11]])) { all.push([b.pose[3], b.pose[7], b.pose[11]]); } });
      wide = bounds(all);
      home = { to: wide.middle, distance: 1.5 * wide.size, turn: -0.95, tilt: 0.42 };
    }

    function reset() { camera = Object.assign({}, home); draw(); }

    // --- one picture

    function paint(part, model, colour, options) {
      options = options || {};
      gl.bindBuffer(gl.ARRAY_BUFFER, part.buffer);
      gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 24, 0);
      gl.vertexAttribPointer(normal, 3, gl.FLOAT, false, 24, 12);
      gl.uniformMatrix4fv(where.model, false, model);
      gl.uniformMatrix3fv(where.turn, false, normals(model));
      gl.uniform4f(where.colour, colour[0], colour[1], colour[2], options.alpha === undefined ? 1 : options.alpha);
      gl.uniform1f(where.flat_, options.mode === undefined ? 0 : 1);
      gl.uniform1f(where.round, options.mode === gl.POINTS ? 1 : 0);
      gl.uniform1f(where.size, options.size || 1);
      gl.drawArrays(options.mode === undefined ? gl.TRIANGLES : options.mode, 0, part.count);
    }

    function rod(start, end, radius, colour) {
      var way = minus(end, start);
      paint(parts.cylinder, scaled(along(by(plus(start, end), 0.5), way), radius, radius, length(way)), colour);
    }

    function arrow(start, way, radius, colour) {
      var whole = length(way), head = Math.min(5 * radius, 0.6 * whole), neck = plus(start, by(way, 1 - head / (whole || 1)));
      if (whole <= 0) { return; }
      rod(start, neck, radius, colour);
      paint(parts.cone, scaled(along(neck, way), 2.2 * radius, 2.2 * radius, head), colour);
    }

    function ball(p, radius, colour) { paint(parts.sphere, scaled(moved(p), radius, radius, radius), colour); }

    function solid(one, links, colour, options) {
      var m = times(links[one.link], ofRows(one.pose)), s = one.size;
      if (one.form === "box") { paint(parts.box, scaled(m, s[0], s[1], s[2]), colour, options); }
      if (one.form === "cylinder") { paint(parts.cylinder, scaled(m, s[0], s[0], s[1]), colour, options); }
      if (one.form === "sphere") { paint(parts.sphere, scaled(m, s[0], s[0], s[0]), colour, options); }
      if (one.form === "mesh") { paint(parts["mesh" + one.mesh], m, colour, options); }
    }

    // The robot under its load, of glass: where the deflections are shown, as large as they are.
    function bent() {
      var under = scene.postures[index].bent, kind = scene.kinds.find(function (one) { return one.name === "deflection"; }), links;
      if (!under || !shown.deflection || !shown.robot || q !== scene.postures[index].q) { return; }
      links = kinematics(scene, under).links;
      gl.enable(gl.BLEND);
      scene.solids.forEach(function (one) { solid(one, links, kind.colour, { alpha: 0.4 }); });
      gl.disable(gl.BLEND);
    }

    function axes(m, long) {
      var o = [m[12], m[13], m[14]], i;
      for (i = 0; i < 3; i++) { rod(o, plus(o, by([m[4 * i], m[4 * i + 1], m[4 * i + 2]], long)), 0.06 * long, AXES[i]); }
    }

    function posed(one) { return one.on === "flange" ? times(robot.flange, ofRows(one.pose)) : ofRows(one.pose); }

    function targets() {
      return Object.keys(scene.targets).map(function (name) { return { name: name, at: apply(robot.flange, scene.targets[name]) }; });
    }

    function picture() {
      var wide = stage.clientWidth || 300, high = stage.clientHeight || 200, ratio = root.devicePixelRatio || 1, eye, view, labels = [], unit = identity();
      waiting = false;
      if (canvas.width !== Math.round(wide * ratio) || canvas.height !== Math.round(high * ratio)) {
        canvas.width = Math.round(wide * ratio);
        canvas.height = Math.round(high * ratio);
      }
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clearColor(1, 1, 1, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      eye = plus(camera.to, by([Math.cos(camera.tilt) * Math.cos(camera.turn), Math.cos(camera.tilt) * Math.sin(camera.turn), Math.sin(camera.tilt)], camera.distance * Math.max(1, 1.25 * high / wide)));
      view = times(perspective(0.6, wide / high, camera.distance / 50, camera.distance * 20), looking(eye, camera.to));
      gl.uniformMatrix4fv(where.eye, false, view);
      gl.uniform3fv(where.look, minus(eye, camera.to));
      paint(lines.floor, unit, COLOURS.floor, { mode: gl.LINES });
      if (shown.robot) { scene.solids.forEach(function (one) { solid(one, robot.links, COLOURS.robot); }); }
      if (shown.targets) {
        lines.places.forEach(function (one) { paint(one, unit, COLOURS.place, { mode: gl.POINTS, size: 4 * ratio }); });
        targets().forEach(function (one) {
          var o = [robot.flange[12], robot.flange[13], robot.flange[14]];
          rod(o, one.at, 0.003 * size, COLOURS.tool);
          ball(one.at, 0.011 * size, COLOURS.target);
          labels.push({ text: one.name, at: one.at });
        });
      }
      if (shown.frames) {
        scene.frames.forEach(function (one) {
          var m = posed(one), o = [m[12], m[13], m[14]];
          if (!near(o)) { return; }
          axes(m, (one.on === "base" ? 0.1 : 0.05) * size);
          labels.push({ text: one.name, at: o });
        });
      }
      if (scene.tracker && shown.tracker) { sight(labels, unit); }
      scene.kinds.forEach(function (kind, i) {
        if (!shown[kind.name]) { return; }
        paint(lines.arrows[i], unit, kind.colour, { mode: gl.LINES });
        scene.arrows.forEach(function (a) {
          if (a.kind === kind.name && a.posture === index) { arrow(a.start, a.vector, (a.width || 0.006) * size, a.colour || kind.colour); }
        });
      });
      bent();
      if (shown.boxes) {
        gl.enable(gl.BLEND);
        gl.depthMask(false);
        scene.boxes.forEach(function (b) {
          paint(parts.box, scaled(ofRows(b.pose), b.size[0], b.size[1], b.size[2]), COLOURS.boxes, { alpha: 0.45 });
          labels.push({ text: b.name, at: [b.pose[3], b.pose[7], b.pose[11]] });
        });
        gl.depthMask(true);
        gl.disable(gl.BLEND);
      }
      write(labels, view, wide, high);
    }

    function sight(labels, unit) {
      var from = scene.tracker, way = minus(from, home.to), beams = [], stub;
      if (!near(from)) {  // too far to be drawn to scale: an arrow towards it, and how far it is
        stub = by(way, 0.5 * size / length(way));
        arrow(home.to, stub, 0.006 * size, COLOURS.tracker);
        labels.push({ text: words.tracker + ", " + length(way).toPrecision(3) + " " + words.away, at: plus(home.to, stub) });
        return;
      }
      paint(parts.cylinder, scaled(moved(minus(from, [0, 0, 0.03 * size])), 0.02 * size, 0.02 * size, 0.06 * size), COLOURS.tracker);
      ball(plus(from, [0, 0, 0.01 * size]), 0.025 * size, COLOURS.tracker);
      targets().forEach(function (one) { beams.push(from, one.at); });
      if (lines.beams) { gl.deleteBuffer(lines.beams.buffer); }
      lines.beams = strip(beams);
      paint(lines.beams, unit, COLOURS.tracker, { mode: gl.LINES });
    }

    function write(labels, view, wide, high) {
      var taken = [], nodes = names.childNodes, used = 0;
      if (shown.names) {
        labels.forEach(function (one) {
          var p = one.at, w = view[3] * p[0] + view[7] * p[1] + view[11] * p[2] + view[15], s = apply(view, p), x, y, node;
          if (w <= 0) { return; }
          x = Math.round((s[0] / w + 1) * wide / 2 + 12);
          y = Math.round((1 - s[1] / w) * high / 2 - 7);
          while (taken.some(function (t) { return Math.abs(t[0] - x) < 90 && Math.abs(t[1] - y) < 14; })) { y += 14; }
          if (x < 0 || y < 0 || x > wide - 10 || y > high - 10) { return; }
          taken.push([x, y]);
          node = nodes[used] || element("span", "position:absolute;left:0;top:0;white-space:nowrap;text-shadow:0 0 3px #fff,0 0 3px #fff", names);
          node.textContent = one.text;
          node.style.transform = "translate(" + Math.min(x, wide - 7 * one.text.length) + "px," + y + "px)";
          used += 1;
        });
      }
      while (nodes.length > used) { names.removeChild(names.lastChild); }
    }

    function draw() {
      if (!waiting) { waiting = true; root.requestAnimationFrame(picture); }
    }

    // --- what can be chosen

    function controls() {
      var present = { robot: true, targets: true, frames: scene.frames.length, tracker: scene.tracker, boxes: scene.boxes.length, names: true }, kinds = {};
      scene.kinds.forEach(function (kind) {
        kinds[kind.name] = kind;
        present[kind.name] = scene.arrows.some(function (a) { return a.kind === kind.name; });
      });
      bar.textContent = "";
      if (scene.postures.length > 1) { chooser(); }
      Object.keys(present).forEach(function (key) {
        if (!present[key]) { return; }
        if (shown[key] === undefined) { shown[key] = !kinds[key] || kinds[key].shown; }
        if (fixed) { return; }
        var label = element("label", "white-space:nowrap;cursor:pointer", bar), tick = element("input", "margin:0 .3em 0 0;vertical-align:middle", label);
        tick.type = "checkbox";
        tick.checked = shown[key];
        tick.onchange = function () { shown[key] = tick.checked; draw(); };
        label.appendChild(root.document.createTextNode((words[key] || key) + (kinds[key] && kinds[key].note ? " (" + kinds[key].note + ")" : "")));
        if (kinds[key]) { label.style.borderBottom = "2px solid rgb(" + kinds[key].colour.map(function (c) { return Math.round(255 * c); }).join(",") + ")"; }
      });
      var button = element("button", "font:inherit;cursor:pointer", bar);
      button.type = "button";
      button.textContent = words.reset;
      button.onclick = reset;
      canvas.setAttribute("aria-label", scene.name + ". " + words.hint);
      canvas.title = words.hint;
    }

    function chooser() {
      var label = element("label", "display:flex;gap:.5em;align-items:center;flex:1 1 100%", bar);
      var text = element("span", "white-space:nowrap;min-width:11em", label), range = element("input", "flex:1;min-width:6em", label);
      range.type = "range";
      range.min = 0;
      range.max = scene.postures.length - 1;
      range.value = index;
      function named() {
        text.textContent = words.posture + " " + scene.postures[index].name;
        range.setAttribute("aria-valuetext", text.textContent);
      }
      range.oninput = function () { index = Number(range.value); pose(scene.postures[index].q); named(); };
      named();
    }

    function pose(angles) { q = angles; robot = kinematics(scene, q); draw(); }

    function turn(dx, dy) {
      camera.turn -= dx;
      camera.tilt = Math.max(-1.5, Math.min(1.5, camera.tilt + dy));
      draw();
    }

    function zoom(factor) {
      camera.distance = Math.max(0.1 * size, Math.min(40 * size, camera.distance * factor));
      draw();
    }

    canvas.addEventListener("pointerdown", function (e) {
      fingers[e.pointerId] = [e.clientX, e.clientY];
      canvas.setPointerCapture(e.pointerId);
      apart = 0;
    });
    canvas.addEventListener("pointermove", function (e) {
      var before = fingers[e.pointerId], all, now;
      if (!before) { return; }
      fingers[e.pointerId] = [e.clientX, e.clientY];
      all = Object.keys(fingers).map(function (key) { return fingers[key]; });
      if (all.length === 2) {
        now = Math.hypot(all[0][0] - all[1][0], all[0][1] - all[1][1]) || 1;
        if (apart) { zoom(apart / now); }
        apart = now;
      } else if (e.shiftKey) {
        camera.to = plus(camera.to, by([Math.sin(camera.turn), -Math.cos(camera.turn), 0], (e.clientX - before[0]) * camera.distance / 900));
        camera.to = plus(camera.to, [0, 0, (e.clientY - before[1]) * camera.distance / 900]);
        draw();
      } else { turn((e.clientX - before[0]) * 0.008, (e.clientY - before[1]) * 0.008); }
    });
    ["pointerup", "pointercancel"].forEach(function (name) {
      canvas.addEventListener(name, function (e) { delete fingers[e.pointerId]; apart = 0; });
    });
    canvas.addEventListener("wheel", function (e) { e.preventDefault(); zoom(Math.exp(0.0012 * e.deltaY)); }, { passive: false });
    canvas.addEventListener("keydown", function (e) {
      var keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
      if (keys[e.key]) { turn(keys[e.key][0], keys[e.key][1]); } else if (e.key === "+") { zoom(0.85); } else if (e.key === "-") { zoom(1.18); } else if (e.key === "Home") { reset(); } else { return; }
      e.preventDefault();
    });
    canvas.addEventListener("webglcontextlost", function (e) { e.preventDefault(); });
    canvas.addEventListener("webglcontextrestored", function () { prepare(); draw(); });
    var watcher = root.ResizeObserver ? new root.ResizeObserver(draw) : null;
    if (watcher) { watcher.observe(stage); }

    function begin() {
      index = Math.min(index, scene.postures.length - 1);
      frame();
      controls();
      pose(scene.postures[index].q);
    }

    begin();
    prepare();
    reset();

    return {
      select: function (i) { index = i; controls(); pose(scene.postures[i].q); },
      posture: function (angles) { pose(angles); },
      arrows: function (list) { scene.arrows = list; controls(); lined(); draw(); },
      places: function (another) { scene.places = another; lined(); draw(); },
      targets: function (places) { scene.targets = places; draw(); },
      scene: function (another) { scene = another; begin(); load(); reset(); },
      dispose: function () {
        var lose = gl.getExtension("WEBGL_lose_context");
        if (watcher) { watcher.disconnect(); }
        if (lose) { lose.loseContext(); }
        place.removeChild(box);
      },
      paint: picture,
      flange: function () { return Array.from(robot.flange); },
    };
  }

  root.calibrationScene = calibrationScene;
})(typeof window === "undefined" ? globalThis : window);
