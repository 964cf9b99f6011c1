// The part of each of sixteen lobes that reaches a texel: `visibility::occlusion::light_rows`. Texels without a place on the surface
// get 0, so that filtering them and dividing by the filtered coverage leaves them out.

uniform highp usampler2D hidden;
// Normal of each texel, and whether it has a place on the surface.
uniform sampler2D normals;
// The lobes widened by a cell of the directions.
uniform sampler2D lobes;
// Each lobe at each direction, four lobes a texel.
uniform sampler2D weights;
uniform sampler2D sky;
uniform int directions;
uniform int firstLobe;
uniform int lobeCount;

layout(location = 0) out vec4 parts0;
layout(location = 1) out vec4 parts1;
layout(location = 2) out vec4 parts2;
layout(location = 3) out vec4 parts3;

vec4 partsOf(int first, vec4 behind, vec3 n) {
    float cell = 4.0 * PI / float(directions);
    vec4 parts = vec4(1.0);
    for (int i = 0; i < 4 && first + i < lobeCount; i++) {
        vec3 axis = texelFetch(lobes, ivec2(0, first + i), 0).xyz;
        float tail = texelFetch(lobes, ivec2(3, first + i), 0).x;
        float whole = cosineIntegral(texelFetch(lobes, ivec2(2, first + i), 0), tail, dot(n, axis));
        parts[i] = clamp(1.0 - behind[i] * cell / max(whole, 1e-9), 0.0, 1.0);
    }
    return parts;
}

void main() {
    ivec2 texel = ivec2(gl_FragCoord.xy);
    vec4 at = texelFetch(normals, texel, 0);
    parts0 = parts1 = parts2 = parts3 = vec4(0.0);
    if (at.w == 0.0) {
        return;
    }
    int row = texel.y * textureSize(normals, 0).x + texel.x;
    int blocks = (directions + 127) / 128;
    int groups = textureSize(weights, 0).x;
    vec4 behind0 = vec4(0.0), behind1 = vec4(0.0), behind2 = vec4(0.0), behind3 = vec4(0.0);
    for (int block = 0; block < blocks; block++) {
        int place = row * blocks + block;
        uvec4 bits = texelFetch(hidden, ivec2(place & 4095, place >> 12), 0);
        for (int w = 0; w < 4; w++) {
            uint word = bits[w];
            for (int bit = 0; word != 0u; bit++) {
                if ((word & 1u) != 0u) {
                    int d = block * 128 + w * 32 + bit;
                    float cosine = dot(texelFetch(sky, ivec2(d, 0), 0).xyz, at.xyz);
                    int group = firstLobe / 4;
                    behind0 += cosine * texelFetch(weights, ivec2(group, d), 0);
                    behind1 += cosine * texelFetch(weights, ivec2(min(group + 1, groups - 1), d), 0);
                    behind2 += cosine * texelFetch(weights, ivec2(min(group + 2, groups - 1), d), 0);
                    behind3 += cosine * texelFetch(weights, ivec2(min(group + 3, groups - 1), d), 0);
                }
                word >>= 1;
            }
        }
    }
    parts0 = partsOf(firstLobe, behind0, at.xyz);
    parts1 = partsOf(firstLobe + 4, behind1, at.xyz);
    parts2 = partsOf(firstLobe + 8, behind2, at.xyz);
    parts3 = partsOf(firstLobe + 12, behind3, at.xyz);
}
