// WebGL2: one program, and textures made once for a frame or camera.

class Gpu {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This page needs WebGL 2, which this browser does not have or has switched off.");
    this.gl = gl;
    this.program = this.linked();
    this.places = new Map();
    gl.useProgram(this.program);
    gl.bindVertexArray(gl.createVertexArray());
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    this.forms = {
      u1: [gl.R8UI, gl.RED_INTEGER, gl.UNSIGNED_BYTE], u2: [gl.R16UI, gl.RED_INTEGER, gl.UNSIGNED_SHORT],
      u4: [gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT], f4: [gl.R32F, gl.RED, gl.FLOAT],
      f4x2: [gl.RG32F, gl.RG, gl.FLOAT], i1x3: [gl.RGB8_SNORM, gl.RGB, gl.BYTE], u1x3: [gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE],
    };
    // Samplers of whole numbers and of others need a texture of their kind even where the program does not read it.
    this.noNumber = this.texture("u1", 1, 1, new Uint8Array([0]));
    this.everywhere = this.texture("u1", 1, 1, new Uint8Array([1]));
    this.noColor = this.texture("u1x3", 1, 1, new Uint8Array(3));
  }

  linked() {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, name] of [[gl.VERTEX_SHADER, "vertex"], [gl.FRAGMENT_SHADER, "fragment"]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, document.getElementById(name).textContent);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader));
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    return program;
  }

  texture(form, width, height, data) {
    const { gl } = this, [inner, format, type] = this.forms[form], made = this.begun(width, height);
    gl.texImage2D(gl.TEXTURE_2D, 0, inner, width, height, 0, format, type, data);
    this.filter(gl.NEAREST, gl.NEAREST, gl.CLAMP_TO_EDGE);
    return made;
  }

  picture(bitmap, wraps) {
    const { gl } = this, made = this.begun(bitmap.width, bitmap.height);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    gl.generateMipmap(gl.TEXTURE_2D);
    this.filter(gl.LINEAR_MIPMAP_LINEAR, gl.LINEAR, wraps ? gl.REPEAT : gl.CLAMP_TO_EDGE);
    return made;
  }

  begun(width, height) {
    const { gl } = this, most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (Math.max(width, height) > most) throw new Error(`This device shows images of up to ${most} pixels a side; this one has ${width} x ${height}.`);
    const made = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, made);
    return made;
  }

  filter(small, large, around) {
    const { gl } = this, set = (key, value) => gl.texParameteri(gl.TEXTURE_2D, key, value);
    set(gl.TEXTURE_MIN_FILTER, small);
    set(gl.TEXTURE_MAG_FILTER, large);
    set(gl.TEXTURE_WRAP_S, around);
    set(gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  }

  release(textures) {
    Object.values(textures).forEach((each) => this.gl.deleteTexture(each));
  }

  place(name) {
    if (!this.places.has(name)) this.places.set(name, this.gl.getUniformLocation(this.program, name));
    return this.places.get(name);
  }

  // Draw a port [x, y, width, height] within a clip of the same form, px from the lower left corner.
  draw(port, clip, numbers, textures) {
    const { gl } = this;
    gl.viewport(...port);
    gl.scissor(...clip);
    gl.enable(gl.SCISSOR_TEST);
    gl.uniform4f(this.place("uPort"), ...port);
    for (const [name, [kind, ...values]] of Object.entries(numbers)) {
      if (kind === "3x3") gl.uniformMatrix3fv(this.place(name), false, transposed(values[0]).flat());
      else gl[`uniform${kind}`](this.place(name), ...values);
    }
    Object.entries(textures).forEach(([name, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(this.place(name), unit);
    });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
