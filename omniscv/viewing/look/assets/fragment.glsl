#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;

uniform vec4 uPort;         // left, bottom, width, height of the port, px of the screen
uniform int uSamples;       // along each side of a pixel of the screen
uniform bool uFlat, uStereographic, uClosed;
uniform float uFocal;       // px of the screen in a radian at the middle
uniform mat3 uCameraView, uWorldView;
uniform vec3 uPlane;        // flat: the image's u, v at the middle, and its px in one of the screen
uniform vec2 uSize;         // of the image, px
uniform int uCells, uFine;
uniform usampler2D uKinds;
uniform sampler2D uNodes, uTables;

uniform int uForm;          // 0 picture, 1 ids, 2 scalar, 3 vectors, 4 marks
uniform sampler2D uPicture, uScalar, uVectors, uPalette, uRamp;
uniform usampler2D uIds, uFocusIds, uMarks, uValid;
uniform float uLevel;       // log2 of the image's px in one of the screen
uniform vec2 uEnds;         // of the scale, natural logarithms
uniform uint uFocus, uBit, uHatch;

out vec4 color;

const float PI = 3.141592653589793;
const vec3 GROUND = vec3(0.051, 0.063, 0.078), SKY = vec3(0.86, 0.88, 0.91);

vec3 viewRay(vec2 at) {
  if (!uStereographic) return normalize(vec3(at, 1.0));
  float quarter = dot(at, at) / 4.0;
  return vec3(at, 1.0 - quarter) / (1.0 + quarter);
}

bool tablePixel(vec3 d, out vec2 pixel) {
  vec3 size = abs(d);
  int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
  vec2 at = vec2(d[(axis + 1) % 3], d[(axis + 2) % 3]) / size[axis];
  int face = 2 * axis + (d[axis] < 0.0 ? 1 : 0);
  vec2 place = (at + 1.0) * 0.5 * float(uCells);
  ivec2 cell = clamp(ivec2(place), ivec2(0), ivec2(uCells - 1));
  vec2 part = place - vec2(cell);
  uint kind = texelFetch(uKinds, ivec2(cell.x, face * uCells + cell.y), 0).r;
  if (kind == 0u) return false;
  if (kind == 1u) {
    ivec2 node = ivec2(cell.x, face * (uCells + 1) + cell.y);
    vec2 top = mix(texelFetch(uNodes, node, 0).rg, texelFetch(uNodes, node + ivec2(1, 0), 0).rg, part.x);
    vec2 low = mix(texelFetch(uNodes, node + ivec2(0, 1), 0).rg, texelFetch(uNodes, node + ivec2(1, 1), 0).rg, part.x);
    pixel = mix(top, low, part.y);
    return true;
  }
  ivec2 fine = clamp(ivec2(part * float(uFine)), ivec2(0), ivec2(uFine - 1));
  int index = (int(kind - 2u) * uFine + fine.y) * uFine + fine.x;
  pixel = texelFetch(uTables, ivec2(index % 2048, index / 2048), 0).rg;
  return pixel.x >= 0.0;
}

bool pixelOf(vec3 d, out vec2 pixel) {
  if (!uClosed) return tablePixel(d, pixel);
  pixel = uSize * vec2(atan(d.x, d.z) / (2.0 * PI) + 0.5, 0.5 + asin(clamp(d.y, -1.0, 1.0)) / PI);
  return true;
}

vec3 outside(vec3 w) {
  if (uFlat) return GROUND;
  // A net of the sphere every 15 degrees, so that one sees where one looks.
  vec2 turn = vec2(atan(w.y, w.x), asin(clamp(w.z, -1.0, 1.0))) * 12.0 / PI;
  vec2 off = abs(fract(turn + 0.5) - 0.5) * vec2(sqrt(max(0.0, 1.0 - w.z * w.z)), 1.0) * uFocal * PI / 12.0;
  float line = 1.0 - smoothstep(0.4, 1.4, min(off.x, off.y));
  return GROUND + vec3(0.07, 0.08, 0.095) * line;
}

vec3 shown(vec2 pixel, ivec2 at) {
  if (uForm == 0) {
    if (uLevel < -3.0) return texelFetch(uPicture, at, 0).rgb;
    return textureLod(uPicture, pixel / uSize, max(0.0, uLevel)).rgb;
  }
  if (uForm == 1) {
    uint id = texelFetch(uIds, at, 0).r;
    return texelFetch(uPalette, ivec2(id & 255u, id >> 8), 0).rgb;
  }
  if (uForm == 2) {
    float value = texelFetch(uScalar, at, 0).r;
    if (isinf(value)) return SKY;
    float part = (log(max(value, 1e-9)) - uEnds.x) / (uEnds.y - uEnds.x);
    return texelFetch(uRamp, ivec2(clamp(part, 0.0, 1.0) * 255.0 + 0.5, 0), 0).rgb;
  }
  if (uForm == 3) {
    vec3 normal = texelFetch(uVectors, at, 0).rgb;
    return dot(normal, normal) < 0.1 ? GROUND : vec3(normal.x, -normal.y, -normal.z) * 0.5 + 0.5;
  }
  return (texelFetch(uMarks, at, 0).r & uBit) != 0u ? vec3(0.90, 0.62, 0.0) : vec3(0.13, 0.16, 0.20);
}

vec3 seen(vec2 screen) {
  vec2 pixel;
  vec3 view = vec3(0.0);
  bool known;
  if (uFlat) {
    pixel = uPlane.xy + screen * uPlane.z;
    known = all(greaterThanEqual(pixel, vec2(0.0))) && all(lessThan(pixel, uSize));
  } else {
    view = viewRay(screen / uFocal);
    known = pixelOf(uCameraView * view, pixel);
  }
  ivec2 at = clamp(ivec2(pixel), ivec2(0), ivec2(uSize) - 1);
  if (!known || texelFetch(uValid, min(at, textureSize(uValid, 0) - 1), 0).r == 0u) return outside(uWorldView * view);
  vec3 found = shown(pixel, at);
  if (uFocus != 0u && texelFetch(uFocusIds, at, 0).r != uFocus) found = mix(vec3(dot(found, vec3(0.3, 0.6, 0.1))), GROUND, 0.7);
  if (uHatch != 0u && (texelFetch(uMarks, at, 0).r & uHatch) != 0u) {
    float stripe = fract((gl_FragCoord.x + gl_FragCoord.y) / 9.0);
    found = mix(found, stripe < 0.5 ? vec3(0.90, 0.62, 0.0) : vec3(0.05), 0.75);
  }
  return found;
}

void main() {
  vec2 middle = gl_FragCoord.xy - uPort.xy - 0.5 * uPort.zw;
  vec3 sum = vec3(0.0);
  for (int i = 0; i < uSamples * uSamples; i++) {
    vec2 part = (vec2(i % uSamples, i / uSamples) + 0.5) / float(uSamples) - 0.5;
    sum += seen(vec2(1.0, -1.0) * (middle + part));
  }
  color = vec4(sum / float(uSamples * uSamples), 1.0);
}
