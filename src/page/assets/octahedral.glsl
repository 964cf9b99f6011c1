// Directions as points of a square: the sphere's octahedron, with its lower half folded outward. Tables of directions have
// 64 x 64 cells of that square, as masks.js fills them.

const int CELLS = 64;

vec2 signs(vec2 v) {
    return mix(vec2(-1.0), vec2(1.0), greaterThanEqual(v, vec2(0.0)));
}

// The unit direction of a point of the square, 0 to 1.
vec3 direction(vec2 point) {
    vec2 flattened = 2.0 * point - 1.0;
    float z = 1.0 - abs(flattened.x) - abs(flattened.y);
    return normalize(vec3(flattened - max(-z, 0.0) * signs(flattened), z));
}

// The point of the square, 0 to 1, of a direction of any length.
vec2 octahedral(vec3 way) {
    vec3 flattened = way / (abs(way.x) + abs(way.y) + abs(way.z));
    vec2 folded = flattened.z < 0.0 ? (1.0 - abs(flattened.yx)) * signs(flattened.xy) : flattened.xy;
    return 0.5 * folded + 0.5;
}

ivec2 cellOf(vec3 way) {
    return clamp(ivec2(octahedral(way) * float(CELLS)), 0, CELLS - 1);
}

// Number of the lowest bit that is set: the exponent of a power of two.
int lowestBit(uint word) {
    uint lowest = word & (~word + 1u);
    return (floatBitsToInt(float(lowest)) >> 23) - 127;
}
