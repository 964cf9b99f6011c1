// The surface that a pixel shows, in 16-bit numbers: normal, texture coordinates and position. Shading starts from these, once a
// pixel: where triangles are as small as pixels, shading them at once would do most of it in vain.

in vec3 placeInBox;
in vec3 normal;
in vec2 placeInAtlas;

out highp uvec4 result;

void main() {
    uvec2 box = uvec2(packUnorm2x16(placeInBox.xy), packUnorm2x16(vec2(placeInBox.z, 0.0)));
    result = uvec4(packUnorm2x16(octahedral(normal)), packUnorm2x16(placeInAtlas), box);
}
