// Radiance of a surface point: all lobes, all base materials, shadows and reflected light. Follows `shade_closed_form` and
// `visibility::occlusion::point_visibility`; GGX is three SGs for narrow lobes too.

in vec3 position;
in vec3 normal;
in vec2 uv;

uniform vec3 eye;
uniform int show;
uniform vec3 tint;
uniform sampler2D albedoMap;
uniform sampler2D alongMap;
uniform sampler2D tiltMap;
uniform mediump sampler2DArray blendMap;
uniform sampler2D lobes;
uniform int lobeCount;
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

// Irradiance of all lobes; with shadows, and without.
void irradiance(vec3 n, float coverage, out vec3 reaching, out vec3 whole) {
    reaching = whole = vec3(0.0);
    for (int first = 0; first < lobeCount; first += 4) {
        vec4 part = shadowed ? texture(parts, vec3(uv, float(first / 4))) / coverage : vec4(1.0);
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

// Specular light of all lobes on one base material, without shadows.
vec3 specularLight(Facing at, float above, vec4 material, bool ggx) {
    float k = ggx ? 0.42 * material.w * material.w * material.w : (material.w + 1.0) * (material.w + 1.0) / 8.0;
    Facets ndf[3];
    int count = ggx ? 3 : 1;
    float broadest = 1e30;
    for (int m = 0; m < count; m++) {
        vec2 lobe = ggx ? ggxLobe(material.w, m) : vec2(2.0 / pow(material.w, 4.0), 1.0);
        ndf[m] = facets(at, above, k, lobe.x, lobe.y);
        broadest = min(broadest, lobe.x);
    }
    vec3 mirror = at.frame * vec3(-at.view.x, 0.0, at.view.y);
    float wide = 0.25 * broadest;
    vec3 sum = vec3(0.0);
    for (int i = 0; i < lobeCount; i++) {
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
    return max(sum, 0.0);
}

uvec4 hiddenBits(int texel, int block) {
    int at = texel * ((directions + 127) / 128) + block;
    return texelFetch(hidden, ivec2(at & 4095, at >> 12), 0);
}

// Light that comes from what hides a direction of a texel.
vec3 sentFrom(ivec2 texel, int d) {
    int place = int(texelFetch(patchOfTexel, texel, 0).x);
    int hider = int(texelFetch(hiders, ivec2(d, place), 0).x & 4095u);
    return hider == 4095 ? vec3(0.0) : texelFetch(leaving, ivec2(hider, 0), 0).rgb;
}

// Whether anything is hidden from any of four texels.
bool hidesAny(ivec2 texels[4], int width) {
    uvec4 all = uvec4(0u);
    for (int block = 0; block < (directions + 127) / 128; block++) {
        for (int i = 0; i < 4; i++) {
            all |= hiddenBits(texels[i].y * width + texels[i].x, block);
        }
    }
    return (all.x | all.y | all.z | all.w) != 0u;
}

// The ratio of the specular light to that without shadows, around the mirrored view.
vec3 mirroredFactor(vec3 n, vec3 toViewer, float roughness) {
    float up = dot(n, toViewer);
    if (up <= 0.0) {
        return vec3(1.0);
    }
    ivec2 extent = textureSize(albedoMap, 0);
    vec2 place = clamp(uv * vec2(extent) - 0.5, vec2(0.0), vec2(extent - 1));
    ivec2 texels[4];
    texels[0] = ivec2(floor(place));
    texels[3] = min(texels[0] + 1, extent - 1);
    texels[1] = ivec2(texels[3].x, texels[0].y);
    texels[2] = ivec2(texels[0].x, texels[3].y);
    vec2 f = place - floor(place);
    vec4 weights = vec4((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
    for (int i = 0; i < 4; i++) {
        weights[i] *= texelFetch(albedoMap, texels[i], 0).a;
    }
    weights /= max(dot(weights, vec4(1.0)), 1e-6);
    if (!hidesAny(texels, extent.x)) {
        return vec3(1.0);
    }

    vec3 mirror = 2.0 * up * n - toViewer;
    float cell = 0.5 * float(directions);
    float lobe = 2.0 / pow(roughness, 4.0) / (4.0 * max(up, 0.05));
    float sharpness = lobe * cell / (lobe + cell);
    float least = 1.0 - MIRROR_REACH / sharpness;
    // Directions lie on a spiral from +Y to -Y: those near the mirrored view are in a range of it.
    float reach = acos(clamp(least, -1.0, 1.0));
    float polar = acos(clamp(mirror.y, -1.0, 1.0));
    vec2 heights = cos(vec2(max(polar - reach, 0.0), min(polar + reach, PI)));
    vec2 range = 0.5 * ((1.0 - heights) * float(directions) - 1.0);
    int last = min(int(ceil(range.y)), directions - 1);
    vec3 arriving = vec3(0.0), unhidden = vec3(0.0);
    uvec4 bits[4];
    int block = -1;
    bool any = false;
    for (int d = max(int(floor(range.x)), 0); d <= last; d++) {
        vec3 direction = texelFetch(sky, ivec2(d, 0), 0).xyz;
        float near = dot(direction, mirror);
        if (near <= least) {
            continue;
        }
        if (d / 128 != block) {
            block = d / 128;
            for (int i = 0; i < 4; i++) {
                bits[i] = hiddenBits(texels[i].y * extent.x + texels[i].x, block);
            }
        }
        float weight = max(dot(direction, n), 0.0) * exp(sharpness * (near - 1.0));
        vec3 open = texelFetch(sky, ivec2(d, 1), 0).rgb;
        unhidden += open * weight;
        for (int i = 0; i < 4; i++) {
            vec3 light = open;
            if (weights[i] > 0.0 && (bits[i][d / 32 & 3] >> (d & 31) & 1u) != 0u) {
                light = sentFrom(texels[i], d);
                any = true;
            }
            arriving += light * (weight * weights[i]);
        }
    }
    if (!any) {
        return vec3(1.0);
    }
    float least3 = 1e-6 * max(dot(unhidden, vec3(0.2126, 0.7152, 0.0722)), 1e-20);
    return clamp(arriving / max(unhidden, vec3(least3)), 0.0, MOST_MIRRORED);
}

// How far the point is from the line of each place.
float away[3];

// As `distance_to_segment` of `pass::edit`.
float distanceToSegment(vec3 start, vec3 end) {
    vec3 offset = position - start, along = end - start;
    float squared = dot(along, along);
    float t = squared > 0.0 ? clamp(dot(offset, along) / squared, 0.0, 1.0) : 0.0;
    return distance(offset, t * along);
}

void findPlaces() {
    for (int r = 0; r < regionCount; r++) {
        int first = r * MOST_POINTS;
        away[r] = distance(position, regionPoint[first]);
        for (int i = first + 1; i < first + regionLength[r]; i++) {
            away[r] = min(away[r], distanceToSegment(regionPoint[i - 1], regionPoint[i]));
        }
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

// Dashes along the outline of the marked place.
vec3 outlined(vec3 shown) {
    if (mark < 0) {
        return shown;
    }
    float outside = away[mark] - regionSize[mark].x;
    float dash = step(0.5, fract((gl_FragCoord.x + gl_FragCoord.y) / 14.0));
    return abs(outside) < 1.2 * fwidth(outside) ? vec3(dash) : shown;
}

void main() {
    vec3 n = normalize(normal);
    vec3 toViewer = normalize(eye - position);
    findPlaces();
    vec4 base = texture(albedoMap, uv);
    vec3 along = tinted(texture(alongMap, uv).rgb);
    vec3 straight = tinted(base.rgb);
    vec3 albedo = mix(along, straight, clamp(dot(n, toViewer), 0.0, 1.0));
    vec3 tilt = (255.0 * texture(tiltMap, uv).rgb - 128.0) / 124.0;
    vec3 mean = (2.0 * straight + along) / 3.0;
    albedo = clamp(albedo + mean * dot(tilt, toViewer - n * dot(n, toViewer)), 0.0, 1.0);
    float coverage = max(base.a, 1e-3);
    vec4 blendLow = blended ? texture(blendMap, vec3(uv, 0.0)) : vec4(1.0, 0.0, 0.0, 0.0);
    vec4 blendHigh = blended ? texture(blendMap, vec3(uv, 1.0)) : vec4(0.0);
    float weightSum = 0.0, roughness = 0.0;
    float weights[8];
    vec4 here[8];
    for (int m = 0; m < materialCount; m++) {
        int number = kinds[m].x;
        here[m] = shined(materials[m]);
        weights[m] = number < 4 ? blendLow[number] : blendHigh[number - 4];
        weightSum += weights[m];
        roughness += weights[m] * here[m].w;
    }
    roughness = weightSum > 0.0 ? roughness / weightSum : 1.0;

    vec3 shown = vec3(0.0);
    if (show == ALBEDO) {
        shown = albedo;
    } else if (show == NORMALS) {
        shown = 0.5 * n + 0.5;
    } else if (show == ROUGHNESS) {
        shown = vec3(roughness);
    } else {
        if (show != SPECULAR) {
            vec3 reaching, whole;
            irradiance(n, coverage, reaching, whole);
            if (show == VISIBILITY) {
                float light = dot(whole, vec3(0.2126, 0.7152, 0.0722));
                shown = vec3(light > 0.0 ? dot(reaching, vec3(0.2126, 0.7152, 0.0722)) / light : 1.0);
            } else {
                vec4 bounced = shadowed ? texture(indirect, uv) : vec4(0.0, 0.0, 0.0, 1.0);
                shown = max((reaching + bounced.rgb / max(bounced.a, 1e-3)) * albedo / PI, 0.0);
            }
        }
        if (show == FULL || show == SPECULAR) {
            Facing at = facing(n, toViewer);
            vec3 specular = vec3(0.0);
            for (int m = 0; m < materialCount; m++) {
                if (weights[m] > 0.0) {
                    specular += weights[m] * specularLight(at, dot(n, toViewer), here[m], kinds[m].y != 0);
                }
            }
            shown += specular * (shadowed ? mirroredFactor(n, toViewer, roughness) : vec3(1.0));
        }
    }
    shown = outlined(shown);
    result = vec4(min(shown, 60000.0 / 16.0), 1.0);
}
