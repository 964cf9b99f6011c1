// The mesh: 16-bit numbers to positions, normals and texture coordinates. Positions and texture coordinates stay fractions of their
// ranges, as the buffer of the surface keeps them.

layout(location = 0) in vec3 place;
layout(location = 1) in vec2 bent;
layout(location = 2) in vec2 texturePlace;

uniform mat4 clipFromWorld;
uniform vec3 low;
uniform vec3 size;

out vec3 placeInBox;
out vec3 normal;
out vec2 placeInAtlas;

void main() {
    placeInBox = place;
    normal = direction(bent);
    placeInAtlas = texturePlace;
    gl_Position = clipFromWorld * vec4(low + size * place, 1.0);
}
