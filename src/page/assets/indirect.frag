// Irradiance of each texel from what hides its directions: `visibility::occlusion::Bounce`.

uniform highp usampler2D hidden;
uniform highp usampler2D patchOfTexel;
uniform highp usampler2D hiders;
uniform sampler2D normals;
uniform sampler2D leaving;
uniform sampler2D sky;
uniform int directions;

out vec4 result;

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    vec4 at = texelFetch(normals, texel, 0);
    result = vec4(0.0);
    if (at.w == 0.0) {
        return;
    }
    int row = texel.y * textureSize(normals, 0).x + texel.x;
    int blocks = (directions + 127) / 128;
    int place = int(texelFetch(patchOfTexel, texel, 0).x);
    vec3 sum = vec3(0.0);
    for (int block = 0; block < blocks; block++) {
        int from = row * blocks + block;
        uvec4 bits = texelFetch(hidden, ivec2(from & 4095, from >> 12), 0);
        for (int w = 0; w < 4; w++) {
            uint word = bits[w];
            for (int bit = 0; word != 0u; bit++) {
                if ((word & 1u) != 0u) {
                    int d = block * 128 + w * 32 + bit;
                    int hider = int(texelFetch(hiders, ivec2(d, place), 0).x & 4095u);
                    if (hider != 4095) {
                        float cosine = dot(texelFetch(sky, ivec2(d, 0), 0).xyz, at.xyz);
                        sum += cosine * texelFetch(leaving, ivec2(hider, 0), 0).rgb;
                    }
                }
                word >>= 1;
            }
        }
    }
    result = vec4(sum * (4.0 * PI / float(directions)), 1.0);
}
