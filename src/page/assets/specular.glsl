// The specular integral of a light lobe over SGs of half vectors: `accurate::specular`, `rule` and `point` in Lobelia's crate of
// kernels, with the 3 x 2 nodes of its default quality.

const float COSINE_FLOOR = 0.05;
const float HALF_FLOOR = 1e-3;
const float LIFT = 0.3;
const float CHART_LIMIT = 3.0;

// Tangent (in the plane of normal and view), bitangent and normal as columns; the view along the first and last.
struct Facing {
    mat3 frame;
    vec2 view;
};

// One SG of the distribution of normals.
struct Facets {
    float sharpness;
    float start;
    float scale;
};

// A Gaussian that the horizon cuts.
struct Clipped {
    float shift;
    float width;
    float share;
    float mass;
    float tau;
    float gap2;
};

Facing facing(vec3 normal, vec3 toViewer) {
    vec3 other = normal.x * normal.x < 0.5 ? vec3(1.0, 0.0, 0.0) : vec3(0.0, 1.0, 0.0);
    other -= normal * dot(normal, other);
    vec3 along = toViewer - normal * dot(normal, toViewer);
    vec3 tangent = dot(along, along) < 1e-8 ? other : along;
    tangent = normalize(tangent);
    tangent = normalize(tangent - normal * dot(normal, tangent));
    mat3 frame = mat3(tangent, cross(normal, tangent), normal);
    return Facing(frame, max(vec2(dot(tangent, toViewer), dot(normal, toViewer)), 0.0));
}

// An SG of sharpness L and weight w, D = w L/2pi e^(L(h.n - 1)), as seen from a point; k is (R + 1)^2/8.
Facets facets(Facing at, float above, float k, float sharpness, float weight) {
    float masked = above > 0.0 ? 0.5 / PI / (at.view.y * (1.0 - k) + k) : 0.0;
    float steep = sharpness * at.view.y;
    float root = sqrt(steep * steep + 8.0 * sharpness * at.view.x * at.view.x);
    float start = min(4.0 * at.view.x / max(steep + root, 1e-6), 1.0);
    return Facets(sharpness, start, masked * sharpness * weight);
}

// GGX as three SGs: sharpness and weight of one.
vec2 ggxLobe(float roughness, int index) {
    vec2 fit = index == 0 ? vec2(2.14567006, 0.70146)
             : index == 1 ? vec2(0.55974909, 0.267075) : vec2(0.100521506, 0.01969698);
    float square = roughness * roughness;
    float alpha2 = square * square;
    float scaled = max(1.0 / alpha2 - 1.0, 1e-2) * fit.x;
    float sharpness = scaled * (2.0 - 1.0 / (2.0 * scaled + 1.0));
    return vec2(sharpness, 2.0 * fit.y / (alpha2 * sharpness));
}

Clipped clipped(float t) {
    float root = sqrt(t * t + 4.0);
    float m = 0.5 * (root + abs(t));
    float narrow = inversesqrt(m * root);
    float wide = m * narrow;
    float tau = t / root;
    float gap = 0.5 * (1.0 - tau);
    float gap2 = gap * gap;
    float p = 0.1791278;
    p = p * tau + 0.5248399;
    p = p * tau + 0.36396699;
    p = p * tau - 0.12435211;
    p = p * tau - 0.37610475;
    p = p * tau - 0.39857341;
    p = p * tau - 0.52792871;
    p = p * tau - 0.27863366;
    return Clipped(t < 0.0 ? m : 1.0 / m, t < 0.0 ? narrow : wide, t < 0.0 ? wide : narrow, p * gap2 + 1.0, tau, gap2);
}

// Distances of the three nodes from the peak, in units of its width.
vec3 nodeOffsets(Clipped rule) {
    vec3 p = vec3(2.4109737, -0.1183123, -4.3110822);
    p = p * rule.tau + vec3(7.7177806, 3.3382652, 1.3345721);
    p = p * rule.tau + vec3(9.7692081, 5.7221413, 7.6940795);
    p = p * rule.tau + vec3(8.1328012, 4.8373994, 5.6697588);
    p = p * rule.tau + vec3(6.2772404, 3.2836375, 2.1943723);
    p = p * rule.tau + vec3(4.268551, 2.9982697, 3.5220099);
    return p * rule.gap2 + vec3(-1.7320508, 0.0, 1.7320508);
}

vec3 nodeWeights(Clipped rule) {
    vec3 p = vec3(0.064161864, 0.17126932, -0.23543119);
    p = p * rule.tau + vec3(0.83404027, 0.0012346291, -0.8352749);
    p = p * rule.tau + vec3(1.568209, -0.47437752, -1.0938314);
    p = p * rule.tau + vec3(1.5278404, -0.69744621, -0.83039414);
    p = p * rule.tau + vec3(1.1530788, -0.59462394, -0.55845486);
    p = p * rule.tau + vec3(0.84431388, -0.47550393, -0.36880995);
    return p * rule.gap2 + vec3(1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0);
}

// The gradient of v.h at X in the chart, with q = cos(theta/2) and quarter = 1/4q.
vec2 viewHalfGradient(vec2 view, vec2 x, float q, float quarter) {
    float pull = view.x * x.x * quarter + view.y;
    return vec2(view.x * q - pull * x.x, -pull * x.y);
}

// Where the rule is first put: between the half vector of the light's axis and the peak of the distribution of normals.
vec2 startOf(vec2 view, Facets ndf, vec3 axis, float sharpness) {
    float up = max(axis.z, 1.0 / (sharpness + 1.0 / LIFT));
    vec3 sum = vec3(view.x + axis.x, axis.y, view.y + up);
    vec3 halfway = sum * inversesqrt(max(dot(sum, sum), 1e-12));
    float q2 = 0.5 * (halfway.z + 1.0);
    float inverseQ = inversesqrt(q2);
    vec2 x = halfway.xy * inverseQ;
    vec2 gradient = viewHalfGradient(view, x, q2 * inverseQ, 0.25 * inverseQ);
    float viewHalf = max(view.x * halfway.x + view.y * halfway.z, 0.0);
    float four = 4.0 * sharpness;
    float alpha = four * viewHalf * viewHalf + ndf.sharpness;
    vec2 pull = vec2(ndf.start - x.x, -x.y);
    float beta = dot(gradient, gradient) * four + alpha;
    float inverse = ndf.sharpness / (alpha * beta);
    return x + inverse * beta * pull - four * inverse * dot(gradient, pull) * gradient;
}

// One light lobe of unit amplitude in the point's frame: specular light for specular albedo s is result.x + result.y s.
vec2 specularOf(Facing at, float k, Facets ndf, vec3 axis, float sharpness) {
    vec2 view = at.view;
    vec2 x = startOf(view, ndf, axis, sharpness);

    // The logarithm of the integrand to second order, without n.w.
    float radius2 = min(dot(x, x), CHART_LIMIT);
    float q2 = 1.0 - 0.25 * radius2;
    float inverseQ = inversesqrt(q2);
    float q = q2 * inverseQ;
    float quarter = 0.25 * inverseQ;
    float up = 1.0 - 0.5 * radius2;
    float viewHalf = max(q * view.x * x.x + view.y * up, HALF_FLOOR);
    vec2 viewGradient = viewHalfGradient(view, x, q, quarter);
    float side = dot(axis.xy, x);
    float axisHalf = q * side + axis.z * up;
    vec2 axisGradient = q * axis.xy - (side * quarter + axis.z) * x;
    float cosine = 2.0 * viewHalf * up - view.y;
    float floored = max(cosine, COSINE_FLOOR);
    float overHalf = 1.0 / viewHalf;
    float overCosine = 4.0 / floored;
    float twice = 2.0 * sharpness;
    vec2 gradient = twice * viewHalf * axisGradient + (twice * axisHalf + overHalf) * viewGradient - ndf.sharpness * x;
    float four = 4.0 * sharpness;
    float spread = four * viewHalf * viewHalf;
    float rounding = spread * (q2 + 1.0) * inverseQ * quarter;
    float isotropic = spread * q2 + ndf.sharpness + viewHalf * max(up, 0.0) * overCosine + 1.0;
    vec2 apart = viewGradient - x;
    float most = 3.0 * isotropic / max(dot(apart, apart), 1e-6);
    float mixed = min(cosine < floored ? 0.0 : overCosine, most);
    float radial = overHalf * overHalf + four;
    vec2 g = 2.0 * up * viewGradient - 2.0 * viewHalf * x;
    vec2 ag = radial * viewGradient + 0.5 * mixed * x;
    vec2 bx = rounding * x + 0.5 * mixed * viewGradient;
    float xx = ag.x * viewGradient.x + bx.x * x.x + isotropic;
    float xy = ag.x * viewGradient.y + bx.x * x.y;
    float yy = ag.y * viewGradient.y + bx.y * x.y + isotropic;

    // The peak, and the widths along and across the direction in which n.w changes.
    if (dot(g, g) < 1e-8) {
        g.x += g.x < 0.0 ? -1e-4 : 1e-4;
    }
    float inverse = 1.0 / max(xx * yy - xy * xy, 1e-4 * xx * yy);
    vec2 steepest = vec2(yy * g.x - xy * g.y, xx * g.y - xy * g.x);
    vec2 step = vec2(yy * gradient.x - xy * gradient.y, xx * gradient.y - xy * gradient.x);
    float inverseRoot = sqrt(inverse);
    float inverseScale = inversesqrt(max(dot(g, steepest) * inverse, 1e-20));
    Clipped rule = clipped((dot(g, step) * inverse + cosine) * inverseScale);
    float unit = inverse * inverseScale;
    vec2 peak = x + inverse * step + unit * rule.shift * steepest;
    vec2 along = unit * rule.width * steepest;
    vec2 across = inverseScale * inverseRoot * vec2(-g.y, g.x);
    float mass = 2.0 * PI * inverseRoot * rule.mass * rule.width;

    vec3 offsets = nodeOffsets(rule);
    vec3 weights = mass * nodeWeights(rule) / (1.0 + rule.share * offsets);
    vec3 reach = rule.width * offsets;
    vec3 exponents = reach * (0.5 * reach + rule.shift);
    float powered = 0.0;
    float plain = 0.0;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 2; j++) {
            vec2 node = peak + offsets[i] * along + (j == 0 ? -across : across);
            float drop = 0.5 * dot(node, node);
            vec2 halfXY = sqrt(1.0 - 0.5 * min(drop, 1.0)) * node;
            float halfZ = 1.0 - drop;
            float vh = max(view.x * halfXY.x + view.y * halfZ, 0.0);
            vec3 omega = vec3(2.0 * vh * halfXY.x - view.x, 2.0 * vh * halfXY.y, 2.0 * vh * halfZ - view.y);
            vec3 away = omega - axis;
            float exponent = exponents[i] - ndf.sharpness * drop - 0.5 * sharpness * dot(away, away);
            float nw = max(omega.z, 0.0);
            float value = 0.8243606353500641 * weights[i] * fadingExp(exponent) * vh * nw / (nw * (1.0 - k) + k);
            plain += value;
            powered += value * exp2(-(5.55473 * vh + 6.8316) * vh);
        }
    }
    return ndf.scale * vec2(powered, plain - powered);
}
