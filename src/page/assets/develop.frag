// The mean of a pixel's samples as a color of the display: exposure, clipping and sRGB, as in Lobelia's PNGs.

uniform sampler2D sum;
uniform float samples;
// Texels of the sum along each side of a pixel.
uniform int side;
uniform float exposure;
// 0: radiance; 1: linear color without exposure; 2: shown as it is.
uniform int encoding;
// Color behind the object as it is shown; negative: none, straight alpha.
uniform vec3 backdrop;

out vec4 result;

vec3 encoded(vec3 linear) {
    vec3 c = clamp(linear, 0.0, 1.0);
    return mix(12.92 * c, 1.055 * pow(max(c, 1e-6), vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308)));
}

void main() {
    vec4 total = vec4(0.0);
    for (int i = 0; i < side * side; i++) {
        total += texelFetch(sum, ivec2(gl_FragCoord.xy) * side + ivec2(i % side, i / side), 0);
    }
    float alpha = clamp(total.a / (samples * float(side * side)), 0.0, 1.0);
    vec3 color = total.rgb / max(total.a, 1e-4);
    color = encoding == 2 ? color : encoded(encoding == 0 ? color * exp2(exposure) : color);
    result = backdrop.x < 0.0 ? vec4(color, alpha) : vec4(mix(backdrop, color, alpha), 1.0);
}
