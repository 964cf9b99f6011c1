// The mesh: 16-bit numbers to positions, normals and texture coordinates.

layout(location = 0) in vec3 place;
layout(location = 1) in vec2 bent;
layout(location = 2) in vec2 texturePlace;

uniform mat4 clipFromWorld;
uniform vec3 low;
uniform vec3 size;
uniform vec2 uvLow;
uniform vec2 uvSize;

out vec3 position;
out vec3 normal;
out vec2 uv;

invariant gl_Position;

vec3 direction(vec2 octahedral) {
    vec2 flattened = 2.0 * octahedral - 1.0;
    float z = 1.0 - abs(flattened.x) - abs(flattened.y);
    float fold = max(-z, 0.0);
    return normalize(vec3(flattened - fold * mix(vec2(-1.0), vec2(1.0), greaterThanEqual(flattened, vec2(0.0))), z));
}

void main() {
    position = low + size * place;
    normal = direction(bent);
    uv = uvLow + uvSize * texturePlace;
    gl_Position = clipFromWorld * vec4(position, 1.0);
}
