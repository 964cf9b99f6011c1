// Radiance of a surface point: all lobes, all base materials, shadows and reflected light. Follows `shade_closed_form` and
// `visibility::occlusion::point_visibility`; GGX is three SGs for narrow lobes too.

// What buffer.frag wrote, and the ranges of its numbers.
uniform highp usampler2D surface;
uniform vec3 low;
uniform vec3 size;
uniform vec2 uvLow;
uniform vec2 uvSize;

uniform vec3 eye;
// Length that a pixel spans at unit distance.
uniform float pixelSpan;
uniform int show;
uniform vec3 tint;
uniform sampler2D albedoMap;
uniform sampler2D alongMap;
uniform sampler2D tiltMap;
uniform mediump sampler2DArray blendMap;
uniform sampler2D lobes;
uniform int lobeCount;
// For each base material and cell of directions: bits of the lobes of which something may be mirrored.
uniform highp usampler2D lobeMask;
// Specular albedo and roughness, and the material's number and whether it is GGX.
uniform vec4 materials[8];
uniform ivec2 kinds[8];
uniform int materialCount;
uniform bool blended;

uniform bool shadowed;
uniform mediump sampler2DArray parts;
uniform sampler2D indirect;
uniform highp usampler2D hidden;
uniform highp usampler2D patchOfTexel;
uniform highp usampler2D hiders;
uniform sampler2D leaving;
uniform sampler2D sky;
uniform int directions;
// For each cell of directions: bits of the directions that may be near the mirrored view.
uniform highp usampler2D directionMask;

// Places with edits of their own, around lines through points: those of all places, and how many each has.
const int MOST_POINTS = 48;
uniform int regionCount;
uniform vec3 regionPoint[3 * MOST_POINTS];
uniform int regionLength[3];
// Their radius, the length over which the diffuse edit sets in, and the radius of the material's hard edge.
uniform vec3 regionSize[3];
uniform vec3 regionTint[3];
// The color that the specular albedo moves toward, and how far; then factors on specular albedo and roughness.
uniform vec4 regionColor[3];
uniform vec2 regionGloss[3];
// The place that is outlined, or -1.
uniform int mark;

out vec4 result;

const int FULL = 0, DIFFUSE = 1, SPECULAR = 2, ALBEDO = 3, NORMALS = 4, VISIBILITY = 5, ROUGHNESS = 6;
const float MOST_MIRRORED = 8.0;
const float MIRROR_REACH = 4.0;
const vec3 LUMINANCE = vec3(0.2126, 0.7152, 0.0722);

vec3 position;
vec2 uv;
// The base materials here, how much there is of each, and their mean roughness.
vec4 here[8];
float weights[8];
float roughness;

// Takes the surface of this pixel from the buffer, and returns its normal. Its texture coordinates have no derivatives, since the
// next pixels may show another surface; textures have one level.
vec3 findSurface() {
    uvec4 kept = texelFetch(surface, ivec2(gl_FragCoord.xy), 0);
    position = low + size * vec3(unpackUnorm2x16(kept.z), unpackUnorm2x16(kept.w).x);
    uv = uvLow + uvSize * unpackUnorm2x16(kept.y);
    return direction(unpackUnorm2x16(kept.x));
}

// Irradiance of all lobes; with shadows, and without.
void irradiance(vec3 n, float coverage, out vec3 reaching, out vec3 whole) {
    reaching = whole = vec3(0.0);
    for (int first = 0; first < lobeCount; first += 4) {
        vec4 part = shadowed ? textureLod(parts, vec3(uv, float(first / 4)), 0.0) / coverage : vec4(1.0);
        for (int i = 0; i < 4 && first + i < lobeCount; i++) {
            vec4 shape = texelFetch(lobes, ivec2(0, first + i), 0);
            vec3 amplitude = texelFetch(lobes, ivec2(1, first + i), 0).rgb;
            vec4 terms = texelFetch(lobes, ivec2(2, first + i), 0);
            float tail = texelFetch(lobes, ivec2(3, first + i), 0).x;
            vec3 light = amplitude * cosineIntegral(terms, tail, dot(n, shape.xyz));
            whole += light;
            reaching += light * part[i];
        }
    }
}

// The distribution of normals of a base material as SGs, their number, and the sharpness of the broadest.
int materialFacets(Facing at, float above, float k, float roughness, bool ggx, out Facets ndf[3], out float broadest) {
    int count = ggx ? 3 : 1;
    broadest = 1e30;
    for (int m = 0; m < count; m++) {
        vec2 lobe = ggx ? ggxLobe(roughness, m) : vec2(2.0 / pow(roughness, 4.0), 1.0);
        ndf[m] = facets(at, above, k, lobe.x, lobe.y);
        broadest = min(broadest, lobe.x);
    }
    return count;
}

// Specular light of the lobes in the mask of the base material with this index, without shadows.
vec3 specularLight(Facing at, float above, vec3 mirror, int index, vec4 material, bool ggx) {
    float k = ggx ? 0.42 * material.w * material.w * material.w : (material.w + 1.0) * (material.w + 1.0) / 8.0;
    Facets ndf[3];
    float broadest;
    int count = materialFacets(at, above, k, material.w, ggx, ndf, broadest);
    float wide = 0.25 * broadest;
    int blocks = (lobeCount + 127) / 128;
    ivec2 cell = cellOf(mirror) * ivec2(blocks, 1) + ivec2(0, index * CELLS);
    vec3 sum = vec3(0.0);
    for (int w = 0; w < 4 * blocks; w++) {
        for (uint word = texelFetch(lobeMask, cell + ivec2(w / 4, 0), 0)[w & 3]; word != 0u; word &= word - 1u) {
            int i = 32 * w + lowestBit(word);
            vec4 shape = texelFetch(lobes, ivec2(0, i), 0);
            vec4 amplitude = texelFetch(lobes, ivec2(1, i), 0);
            float narrow = wide * shape.w / (wide + shape.w);
            if (narrow * (1.0 - dot(mirror, shape.xyz)) >= amplitude.w) {
                continue;
            }
            vec3 axis = shape.xyz * at.frame;
            vec2 light = vec2(0.0);
            for (int m = 0; m < count; m++) {
                light += specularOf(at, k, ndf[m], axis, shape.w);
            }
            sum += amplitude.rgb * (light.x + light.y * material.rgb);
        }
    }
    return max(sum, 0.0);
}

// The four texels around this pixel's place in the atlas, and how much each of them counts.
struct Texels {
    ivec2 places[4];
    vec4 weights;
};

Texels texelsAround() {
    ivec2 extent = textureSize(albedoMap, 0);
    vec2 place = clamp(uv * vec2(extent) - 0.5, vec2(0.0), vec2(extent - 1));
    ivec2 first = ivec2(floor(place)), last = min(first + 1, extent - 1);
    vec2 f = place - floor(place);
    vec4 weights = vec4((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
    Texels near = Texels(ivec2[4](first, ivec2(last.x, first.y), ivec2(first.x, last.y), last), weights);
    for (int i = 0; i < 4; i++) {
        near.weights[i] *= texelFetch(albedoMap, near.places[i], 0).a;
    }
    near.weights /= max(dot(near.weights, vec4(1.0)), 1e-6);
    return near;
}

// Which directions of a block are hidden from one of the texels; none if it does not count.
uvec4 hiddenBits(Texels near, int i, int block) {
    int row = near.places[i].y * textureSize(albedoMap, 0).x + near.places[i].x;
    int at = row * ((directions + 127) / 128) + block;
    return near.weights[i] > 0.0 ? texelFetch(hidden, ivec2(at & 4095, at >> 12), 0) : uvec4(0u);
}

// Light that comes from what hides a direction of a texel.
vec3 sentFrom(ivec2 texel, int d) {
    int place = int(texelFetch(patchOfTexel, texel, 0).x);
    int hider = int(texelFetch(hiders, ivec2(d, place), 0).x & 4095u);
    return hider == 4095 ? vec3(0.0) : texelFetch(leaving, ivec2(hider, 0), 0).rgb;
}

// Whether any of the directions in the mask is hidden from any of the texels.
bool hidesMirrored(Texels near, ivec2 cell) {
    uvec4 found = uvec4(0u);
    for (int block = 0; block < (directions + 127) / 128; block++) {
        uvec4 bits = hiddenBits(near, 0, block) | hiddenBits(near, 1, block) | hiddenBits(near, 2, block) | hiddenBits(near, 3, block);
        found |= bits & texelFetch(directionMask, cell + ivec2(block, 0), 0);
    }
    return (found.x | found.y | found.z | found.w) != 0u;
}

// Light around the mirrored view: as it reaches the texels, and as if nothing were hidden; and whether anything is.
struct Mirrored {
    vec3 arriving;
    vec3 unhidden;
    bool any;
};

void addDirection(int d, float weight, bvec4 hides, Texels near, inout Mirrored sum) {
    vec3 open = texelFetch(sky, ivec2(d, 1), 0).rgb;
    sum.unhidden += open * weight;
    for (int i = 0; i < 4; i++) {
        vec3 light = hides[i] ? sentFrom(near.places[i], d) : open;
        sum.arriving += light * (weight * near.weights[i]);
    }
    sum.any = sum.any || any(hides);
}

Mirrored mirroredLight(vec3 n, vec3 mirror, float up, Texels near, ivec2 cell) {
    float width = 0.5 * float(directions);
    float lobe = 2.0 / pow(roughness, 4.0) / (4.0 * max(up, 0.05));
    float sharpness = lobe * width / (lobe + width);
    float least = 1.0 - MIRROR_REACH / sharpness;
    Mirrored sum = Mirrored(vec3(0.0), vec3(0.0), false);
    for (int block = 0; block < (directions + 127) / 128; block++) {
        uvec4 mask = texelFetch(directionMask, cell + ivec2(block, 0), 0);
        uvec4 bits[4];
        for (int i = 0; i < 4; i++) {
            bits[i] = hiddenBits(near, i, block);
        }
        for (int w = 0; w < 4; w++) {
            uvec4 words = uvec4(bits[0][w], bits[1][w], bits[2][w], bits[3][w]);
            for (uint word = mask[w]; word != 0u; word &= word - 1u) {
                int bit = lowestBit(word);
                int d = 128 * block + 32 * w + bit;
                vec3 way = texelFetch(sky, ivec2(d, 0), 0).xyz;
                float along = dot(way, mirror);
                if (along > least) {
                    float weight = max(dot(way, n), 0.0) * exp(sharpness * (along - 1.0));
                    addDirection(d, weight, notEqual(words >> bit & 1u, uvec4(0u)), near, sum);
                }
            }
        }
    }
    return sum;
}

// The ratio of the specular light to that without shadows, around the mirrored view.
vec3 mirroredFactor(vec3 n, vec3 mirror, float up) {
    ivec2 cell = cellOf(mirror) * ivec2((directions + 127) / 128, 1);
    Texels near = texelsAround();
    if (up <= 0.0 || !hidesMirrored(near, cell)) {
        return vec3(1.0);
    }
    Mirrored sum = mirroredLight(n, mirror, up, near, cell);
    if (!sum.any) {
        return vec3(1.0);
    }
    float dark = 1e-6 * max(dot(sum.unhidden, LUMINANCE), 1e-20);
    return clamp(sum.arriving / max(sum.unhidden, vec3(dark)), 0.0, MOST_MIRRORED);
}

// From the line of each place to this point, and how far that is.
vec3 fromLine[3];
float away[3];

// As `distance_to_segment` of `pass::edit`, with the way.
vec3 fromSegment(vec3 start, vec3 end) {
    vec3 offset = position - start, along = end - start;
    float squared = dot(along, along);
    float t = squared > 0.0 ? clamp(dot(offset, along) / squared, 0.0, 1.0) : 0.0;
    return offset - t * along;
}

void findPlaces() {
    for (int r = 0; r < regionCount; r++) {
        int first = r * MOST_POINTS;
        vec3 nearest = position - regionPoint[first];
        for (int i = first + 1; i < first + regionLength[r]; i++) {
            vec3 offset = fromSegment(regionPoint[i - 1], regionPoint[i]);
            nearest = dot(offset, offset) < dot(nearest, nearest) ? offset : nearest;
        }
        fromLine[r] = nearest;
        away[r] = length(nearest);
    }
}

// As `weight_at` of `pass::edit`.
float weightAt(float depth, float falloff) {
    if (depth < 0.0) {
        return 0.0;
    }
    float t = depth < falloff ? depth / falloff : 1.0;
    return t * t * (3.0 - 2.0 * t);
}

// The albedo of a map after the diffuse edits.
vec3 tinted(vec3 albedo) {
    vec3 edited = clamp(albedo * tint, 0.0, 1.0);
    for (int r = 0; r < regionCount; r++) {
        float weight = weightAt(regionSize[r].x - away[r], regionSize[r].y);
        edited = mix(edited, clamp(edited * regionTint[r], 0.0, 1.0), weight);
    }
    return edited;
}

// A base material after the edits of the places that this point is in.
vec4 shined(vec4 material) {
    for (int r = 0; r < regionCount; r++) {
        if (away[r] <= regionSize[r].z) {
            vec3 blended = clamp(mix(material.rgb, regionColor[r].rgb, regionColor[r].a), 0.0, 1.0);
            material.rgb = clamp(blended * regionGloss[r].x, 0.0, 1.0);
            material.w = clamp(material.w * regionGloss[r].y, 0.03, 1.0);
        }
    }
    return material;
}

// Dashes along the outline of the marked place. How fast the distance grows from pixel to pixel follows from the surface here: the
// next pixels may show another one.
vec3 outlined(vec3 shown, vec3 n, vec3 toViewer) {
    if (mark < 0) {
        return shown;
    }
    vec3 outward = fromLine[mark] / max(away[mark], 1e-9);
    vec3 slope = outward - n * (dot(outward, toViewer) / max(dot(n, toViewer), 0.05));
    float growth = length(slope) * pixelSpan * distance(eye, position);
    float dash = step(0.5, fract((gl_FragCoord.x + gl_FragCoord.y) / 14.0));
    return abs(away[mark] - regionSize[mark].x) < 1.5 * growth ? vec3(dash) : shown;
}

// The albedo as it is seen from a side, after the diffuse edits.
vec3 albedoSeen(vec3 base, vec3 n, vec3 toViewer) {
    vec3 along = tinted(textureLod(alongMap, uv, 0.0).rgb);
    vec3 straight = tinted(base);
    vec3 albedo = mix(along, straight, clamp(dot(n, toViewer), 0.0, 1.0));
    vec3 tilt = (255.0 * textureLod(tiltMap, uv, 0.0).rgb - 128.0) / 124.0;
    vec3 mean = (2.0 * straight + along) / 3.0;
    return clamp(albedo + mean * dot(tilt, toViewer - n * dot(n, toViewer)), 0.0, 1.0);
}

void findMaterials() {
    vec4 blendLow = blended ? textureLod(blendMap, vec3(uv, 0.0), 0.0) : vec4(1.0, 0.0, 0.0, 0.0);
    vec4 blendHigh = blended ? textureLod(blendMap, vec3(uv, 1.0), 0.0) : vec4(0.0);
    float weightSum = roughness = 0.0;
    for (int m = 0; m < materialCount; m++) {
        int number = kinds[m].x;
        here[m] = shined(materials[m]);
        weights[m] = number < 4 ? blendLow[number] : blendHigh[number - 4];
        weightSum += weights[m];
        roughness += weights[m] * here[m].w;
    }
    roughness = weightSum > 0.0 ? roughness / weightSum : 1.0;
}

// Diffuse light, or how much of the light arrives.
vec3 diffuseLight(vec3 n, float coverage, vec3 albedo) {
    vec3 reaching, whole;
    irradiance(n, coverage, reaching, whole);
    if (show == VISIBILITY) {
        float light = dot(whole, LUMINANCE);
        return vec3(light > 0.0 ? dot(reaching, LUMINANCE) / light : 1.0);
    }
    vec4 bounced = shadowed ? textureLod(indirect, uv, 0.0) : vec4(0.0, 0.0, 0.0, 1.0);
    return max((reaching + bounced.rgb / max(bounced.a, 1e-3)) * albedo / PI, 0.0);
}

// Specular light of all base materials.
vec3 specularSeen(vec3 n, vec3 toViewer) {
    float up = dot(n, toViewer);
    vec3 mirror = 2.0 * up * n - toViewer;
    Facing at = facing(n, toViewer);
    vec3 specular = vec3(0.0);
    for (int m = 0; m < materialCount; m++) {
        if (weights[m] > 0.0) {
            specular += weights[m] * specularLight(at, up, mirror, m, here[m], kinds[m].y != 0);
        }
    }
    return specular * (shadowed ? mirroredFactor(n, mirror, up) : vec3(1.0));
}

void main() {
    vec3 n = findSurface();
    vec3 toViewer = normalize(eye - position);
    findPlaces();
    vec4 base = textureLod(albedoMap, uv, 0.0);
    vec3 albedo = albedoSeen(base.rgb, n, toViewer);
    findMaterials();

    vec3 shown = vec3(0.0);
    if (show == ALBEDO) {
        shown = albedo;
    } else if (show == NORMALS) {
        shown = 0.5 * n + 0.5;
    } else if (show == ROUGHNESS) {
        shown = vec3(roughness);
    } else if (show != SPECULAR) {
        shown = diffuseLight(n, max(base.a, 1e-3), albedo);
    }
    if (show == FULL || show == SPECULAR) {
        shown += specularSeen(n, toViewer);
    }
    shown = outlined(shown, n, toViewer);
    result = vec4(min(shown, 60000.0 / 16.0), 1.0);
}
