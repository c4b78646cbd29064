// Shading, colours and overlays of a relief, the same for the map and the 3-D view.
//
// Brightness is that of retrosync's pictures: ambient + (1 - ambient) max(0, n·l) of the exaggerated mean slope.

export const AMBIENT = 0.15;
export const HIGHLIGHT = 0.55;

export const VERTEX = `
precision highp float;
precision highp sampler2D;
uniform sampler2D surface;
uniform vec2 padded;
uniform vec2 size;
uniform float lod;
uniform float raise;
uniform float base;
out vec2 at;
void main() {
  at = position.xy * size;
  vec4 here = textureLod(surface, at / padded, lod);
  float z = raise * (here.b + here.a - base);
  gl_Position = projectionMatrix * modelViewMatrix * vec4(at.x - 0.5, 0.5 - at.y, z, 1.0);
}`;

export const FRAGMENT = `
precision highp float;
precision highp sampler2D;
uniform sampler2D surface, valid, palette, frame, sigma, sigmaPalette;
uniform vec2 padded, size;
uniform vec3 light;
uniform float exaggeration, low, high, interval, sigmaHigh, pixelSize;
uniform int colour;
uniform bool shading, curves, hatch, uncertainty, space, grid, squares;
uniform vec3 backdrop, ink;
in vec2 at;
out vec4 shown;

const float AMBIENT = ${AMBIENT.toFixed(2)};
const float HIGHLIGHT = ${HIGHLIGHT.toFixed(2)};

vec3 entry(sampler2D table, float share) {
  return texture(table, vec2((floor(clamp(share, 0.0, 1.0) * 255.0 + 0.5) + 0.5) / 256.0, 0.5)).rgb;
}

vec3 blank() {
  float stripe = step(0.5, fract((gl_FragCoord.x + gl_FragCoord.y) / 10.0 / pixelSize));
  return hatch ? mix(backdrop, ink, 0.10 + 0.16 * stripe) : backdrop;
}

vec3 lit(vec3 tint, float brightness) {
  float flatness = AMBIENT + (1.0 - AMBIENT) * light.z;
  vec3 shaded = tint * min(brightness / flatness, 1.0);
  return shaded + (vec3(1.0) - shaded) * HIGHLIGHT * max(brightness - flatness, 0.0) / max(1.0 - flatness, 1e-4);
}

float height(vec2 place) {
  vec4 there = texture(surface, place / padded);
  return there.b + there.a;
}

// Level curves stay smooth where pixels are drawn as squares.
float smoothHeight() {
  vec2 corner = floor(at - 0.5) + 0.5;
  vec2 share = at - corner;
  vec2 left = vec2(height(corner), height(corner + vec2(0.0, 1.0)));
  vec2 right = vec2(height(corner + vec2(1.0, 0.0)), height(corner + 1.0));
  vec2 both = mix(left, right, share.x);
  return mix(both.x, both.y, share.y);
}

float curve(float z, float step_um, float run) {
  float off = abs(fract(z / step_um + 0.5) - 0.5) * step_um;
  float width = 0.9 * pixelSize;
  return (1.0 - smoothstep(width - 0.5, width + 0.5, off / max(run, 1e-9))) * smoothstep(2.5, 6.0, step_um / max(run, 1e-9));
}

void main() {
  vec2 uv = at / padded;
  vec4 here = texture(surface, uv);
  float z = here.b + here.a;
  float even = squares && curves ? smoothHeight() : z;
  float run = length(vec2(dFdx(even), dFdy(even)));
  float share = texture(valid, uv).r;
  if (share < 0.5) {
    if (space) discard;
    shown = vec4(blank(), 1.0);
    return;
  }
  vec2 slope = here.rg * exaggeration;
  float cosine = (light.z - dot(slope, light.xy)) / sqrt(1.0 + dot(slope, slope));
  float brightness = AMBIENT + (1.0 - AMBIENT) * max(cosine, 0.0);
  vec3 tint = colour == 0 ? entry(palette, (z - low) / (high - low)) : vec3(1.0);
  if (colour == 2) tint = texture(frame, at / size).rgb;
  if (uncertainty) {
    vec4 known = texture(sigma, at / size);
    tint = entry(sigmaPalette, known.r / max(known.g, 1e-3) / sigmaHigh);
  }
  vec3 drawn = tint;
  if (shading) drawn = colour == 1 && !uncertainty ? vec3(brightness) : lit(tint, brightness);
  if (curves) {
    float line = max(0.62 * curve(even, interval, run), 0.95 * curve(even, 5.0 * interval, run));
    float bright = dot(drawn, vec3(0.299, 0.587, 0.114));
    drawn = mix(drawn, vec3(bright > 0.38 ? 0.04 : 0.97), line);
  }
  if (grid) {
    vec2 inside = abs(fract(at) - 0.5);
    vec2 wide = fwidth(at);
    float edge = max(smoothstep(0.5 - wide.x, 0.5, inside.x), smoothstep(0.5 - wide.y, 0.5, inside.y));
    drawn = mix(drawn, vec3(0.5), 0.22 * edge);
  }
  if (space && !gl_FrontFacing) drawn *= 0.45;
  shown = vec4(drawn, 1.0);
}`;
