// Where the nodes of the specular integral lie: around the peak of the product of one light SG and one SG of half vectors, in Lambert's
// chart of half vectors; `lobelia_sg::accurate::placement`.

// Lower bound of n·ω and v·h in the Hessian, which keeps their logarithms bounded near the horizon.
const COSINE_FLOOR = 0.05;
const HALF_FLOOR = 1e-3;
// For a light below the horizon the initial point lies at least 1/(λ + 1/LIFT) above it.
const OVER_LIFT = 3.3333333333333335;
// Largest |X|² at which the integrand is expanded.
const CHART_LIMIT = 3.0;

// A light lobe in a point's frame.
struct LocalLight {
    // Axis along tangent, bitangent and normal.
    axis: vec3<f32>,
    // λ.
    sharpness: f32,
}

// The Gaussian, cut by the horizon, that nodes are placed on.
struct Placement {
    // Peak of the integrand in the chart.
    peak: vec2<f32>,
    // Width along the clipped direction.
    along: vec2<f32>,
    // Standard deviation across it.
    across: vec2<f32>,
    clipped: Clipped,
    // The Gaussian's mass.
    weight: f32,
}

// A symmetric 2×2 matrix: xx, xy, yy.
alias Symmetric = vec3<f32>;

// `s·I + a·ggᵀ + b·xxᵀ + c·(gxᵀ + xgᵀ)/2`.
fn symmetric(s: f32, a: f32, g: vec2<f32>, b: f32, x: vec2<f32>, c: f32) -> Symmetric {
    let ag = a * g + c * 0.5 * x;
    let bx = b * x + c * 0.5 * g;
    return vec3(
        fma(ag.x, g.x, fma(bx.x, x.x, s)),
        fma(ag.x, g.y, bx.x * x.y),
        fma(ag.y, g.y, fma(bx.y, x.y, s)),
    );
}

// 1/determinant; the determinant has a lower bound so that rounding cannot change its sign.
fn inverse_determinant(m: Symmetric) -> f32 {
    let diagonal = m.x * m.z;
    return 1.0 / max(diagonal - m.y * m.y, diagonal * 1e-4);
}

// The adjugate times `v`: the inverse times `v`, up to the determinant.
fn adjugate_times(m: Symmetric, v: vec2<f32>) -> vec2<f32> {
    return vec2(fma(m.z, v.x, -(m.y * v.y)), fma(m.x, v.y, -(m.y * v.x)));
}

// The gradient of v·h at X, with q = √(1 − |X|²/4), given 1/(4q).
fn view_half_gradient(view: vec2<f32>, x: vec2<f32>, q: f32, quarter: f32) -> vec2<f32> {
    let pull = fma(view.x * x.x, quarter, view.y);
    return vec2(fma(view.x, q, -(pull * x.x)), -(pull * x.y));
}

// Initialization of the peak: the half vector of the light and the peak of the NDF, weighted by their curvatures.
fn start_of(point: Point, light: LocalLight) -> vec2<f32> {
    let l = light.sharpness;
    let up = max(light.axis.z, 1.0 / (l + OVER_LIFT));
    let sum = vec3(point.view.x + light.axis.x, light.axis.y, point.view.y + up);
    let half = sum * rough_rsqrt(max(dot(sum, sum), 1e-12));
    // q = cos(θ/2), and X = h_xy/q.
    let q2 = (half.z + 1.0) * 0.5;
    let inverse_q = rough_rsqrt(q2);
    let x = half.xy * inverse_q;
    let gradient = view_half_gradient(point.view, x, q2 * inverse_q, inverse_q * 0.25);
    let view_half = relu(fma(point.view.x, half.x, point.view.y * half.z));
    // x + H⁻¹·L(NDF's peak − x) with H = αI + 4λggᵀ, inverted by Sherman and Morrison's formula.
    let four = l * 4.0;
    let alpha = fma(four * view_half, view_half, point.sharpness);
    let pull = vec2(point.start - x.x, -x.y);
    let beta = fma(dot(gradient, gradient), four, alpha);
    let inverse = point.sharpness / (alpha * beta);
    let along = -(four * inverse * dot(gradient, pull));
    return along * gradient + inverse * beta * pull + x;
}

// The logarithm of the integrand to second order at X, without n·ω.
struct Expansion {
    // n·ω and its gradient.
    cosine: f32,
    cosine_gradient: vec2<f32>,
    gradient: vec2<f32>,
    hessian: Symmetric,
}

fn expand(point: Point, light: LocalLight, x: vec2<f32>) -> Expansion {
    let l = light.sharpness;
    let radius2 = min(dot(x, x), CHART_LIMIT);
    let q2 = radius2 * -0.25 + 1.0;
    let inverse_q = inverseSqrt(q2);
    let q = q2 * inverse_q;
    let quarter = inverse_q * 0.25;
    let up = radius2 * -0.5 + 1.0;
    // ξ·h and v·h, and their gradients.
    let side = dot(light.axis.xy, x);
    let axis_half = fma(q, side, light.axis.z * up);
    let axis_gradient = q * light.axis.xy - fma(side, quarter, light.axis.z) * x;
    let view_half = max(fma(q * point.view.x, x.x, point.view.y * up), HALF_FLOOR);
    let view_gradient = view_half_gradient(point.view, x, q, quarter);
    let cosine = view_half * up * 2.0 - point.view.y;
    let floored = max(cosine, COSINE_FLOOR);
    let over_half = 1.0 / view_half;
    let over_cosine = 4.0 / floored;
    // The negative Hessian: of the light, its metric 4(∇(v·h)∇(v·h)ᵀ + (v·h)²·g) with the chart's g = q²I + (1 + q²)/(4q²)·XXᵀ;
    // and −∇² of ln(v·h), ln(n·ω).
    let spread = l * 4.0 * view_half * view_half;
    let rounding = spread * (q2 + 1.0) * inverse_q * quarter;
    let isotropic = fma(spread, q2, point.sharpness) + view_half * relu(up) * over_cosine + 1.0;
    // The curvature of n·ω is indefinite; it is limited so that a quarter of the isotropic part remains.
    let apart = view_gradient - x;
    let most = isotropic * 3.0 / max(dot(apart, apart), 1e-6);
    let mixed = min(select(over_cosine, 0.0, cosine < floored), most);
    let radial = fma(over_half, over_half, l * 4.0);
    let toward_light = 2.0 * l * view_half * axis_gradient + fma(2.0 * l, axis_half, over_half) * view_gradient;
    return Expansion(
        cosine,
        up * 2.0 * view_gradient - view_half * 2.0 * x,
        toward_light - point.sharpness * x,
        symmetric(isotropic, radial, view_gradient, rounding, x, mixed),
    );
}

// Places the rule for one light and the SG of the NDF: one Gauss–Newton step from the initialization.
fn place(point: Point, light: LocalLight) -> Placement {
    let x = start_of(point, light);
    let at = expand(point, light, x);
    var g = at.cosine_gradient;
    // At the pole of n·ω any direction is valid; the step keeps the sign of g, which it would otherwise cancel.
    g.x += select(0.0, select(1e-4, -1e-4, g.x < 0.0), dot(g, g) < 1e-8);
    let inverse = inverse_determinant(at.hessian);
    let steepest = adjugate_times(at.hessian, g);
    let step = adjugate_times(at.hessian, at.gradient);
    let inverse_root = inverse * inverseSqrt(inverse);
    // Scale s of n·ω per unit standard deviation: s² = gᵀH⁻¹g.
    let inverse_scale = inverseSqrt(max(dot(g, steepest) * inverse, 1e-20));
    let clipped = clip(fma(dot(g, step), inverse, at.cosine) * inverse_scale);
    let unit = inverse * inverse_scale;
    let turn = inverse_scale * inverse_root;
    return Placement(
        x + inverse * step + unit * clipped.shift * steepest,
        unit * clipped.width * steepest,
        vec2(-(turn * g.y), turn * g.x),
        clipped,
        inverse_root * clipped.mass * clipped.width * 2.0 * PI,
    );
}
