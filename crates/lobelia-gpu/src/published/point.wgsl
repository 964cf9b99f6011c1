// The terms of a surface point and its specular material: `lobelia_sg::published::point`.

// The published code divides by |x| + 1e-6 when it normalizes, so its "unit" vectors have this length, κ; 1 − κ; and κ² − 1.
const SHRUNK = 0.999999000001;
const SHRUNK_BY = 9.99999000001e-7;
const SQUARE_SHRUNK_BY = -1.999997000004e-6;
// The constant that the published code adds to denominators.
const TINY = 1e-6;

struct Point {
    normal: vec3<f32>,
    // r = 2(n·v)₊n − v.
    mirror: vec3<f32>,
    // r·n as the published code computes it.
    mirror_cosine: f32,
    // (2/R⁴)/(4 n·v) (Wang et al. 2009).
    warp_sharpness: f32,
}

alias Sums = Point;

// M·N, the BRDF factor M (PhySG supp. eqs. 1–7) frozen at the mirror direction, times the NDF's amplitude 1/(πR⁴), as
// `constant + slope · specular albedo`; derivatives of constant, slope and warp_sharpness with respect to n·v and R.
struct Frozen {
    constant: f32,
    slope: f32,
    by_cosine: vec3<f32>,
    by_roughness: vec3<f32>,
}

// One factor of G (PhySG supp. eqs. 1–7), c/(c(1 − k) + k + 1e-6), and its derivatives with respect to c and R.
fn shadowing_factor(c: f32, k: f32, k_prime: f32) -> vec3<f32> {
    let inverse = 1.0 / (c * (1.0 - k) + k + TINY);
    let value = c * inverse;
    return vec3(value, (k + TINY) * inverse * inverse, -(value * inverse) * (1.0 - c) * k_prime);
}

// F of PhySG supp. eq. 6 without the specular albedo, at the mirror direction, and its derivative with respect to n·v.
fn mirror_fresnel(nv: f32) -> vec2<f32> {
    // h = (r + v)/(|r + v| + 1e-6) with r + v = 2κ(n·v)n + (1 − κ)v.
    let q = nv * 2.0 * SHRUNK;
    let length = sqrt(q * q + q * nv * 2.0 * SHRUNK_BY + SHRUNK_BY * SHRUNK_BY);
    let length_prime = (q * 2.0 * SHRUNK + nv * 4.0 * SHRUNK * SHRUNK_BY) / length;
    let inverse_length = 1.0 / (length + TINY);
    let vh = (q * nv + SHRUNK_BY) * inverse_length;
    let vh_prime = (nv * 4.0 * SHRUNK - vh * length_prime) * inverse_length;
    let power = fresnel_power(vh);
    return vec2(power, -(vh * 2.0 * 5.55473 + 6.8316) * 0.6931471805599453 * power * vh_prime);
}

// Q = G/(4 (n·r)(n·v) + 1e-6) with n·r = κ n·v, and its derivatives with respect to n·v and R.
fn shadowing_quotient(nv: f32, roughness: f32) -> vec3<f32> {
    let k = shadowing_k(roughness);
    let nr = nv * SHRUNK;
    let g1 = shadowing_factor(nr, k.x, k.y);
    let g2 = shadowing_factor(nv, k.x, k.y);
    let inverse = 1.0 / (nr * nv * 4.0 + TINY);
    let quotient = g1.x * g2.x * inverse;
    let by_cosine = (g1.y * SHRUNK * g2.x + g1.x * g2.y - quotient * nv * 8.0 * SHRUNK) * inverse;
    return vec3(quotient, by_cosine, (g1.z * g2.x + g1.x * g2.z) * inverse);
}

// The terms that depend on the point and the specular material but not on the light.
fn prepare_point(normal: vec3<f32>, to_viewer: vec3<f32>, roughness: f32) -> Prepared {
    let nv = relu(dot(normal, to_viewer));
    let square = roughness * roughness;
    let ndf_amplitude = 1.0 / (PI * square * square);
    let warp_denominator = 1.0 / (nv * 4.0 + TINY);
    let warp_sharpness = ndf_amplitude * 2.0 * PI * warp_denominator;
    let fresnel = mirror_fresnel(nv);
    let quotient = shadowing_quotient(nv, roughness);
    let factor = quotient.x * ndf_amplitude;
    let factor_by_c = quotient.y * ndf_amplitude;
    let factor_by_r = (quotient.z - quotient.x * 4.0 / roughness) * ndf_amplitude;
    let rest = 1.0 - fresnel.x;
    let by_cosine = vec3(
        factor_by_c * fresnel.x + factor * fresnel.y,
        factor_by_c * rest - factor * fresnel.y,
        -warp_sharpness * warp_denominator * 4.0,
    );
    let by_roughness = vec3(factor_by_r * fresnel.x, factor_by_r * rest, -warp_sharpness / roughness * 4.0);
    let point = Point(normal, normal * (nv * 2.0) - to_viewer, nv * SHRUNK, warp_sharpness);
    return Prepared(point, Frozen(factor * fresnel.x, factor * rest, by_cosine, by_roughness));
}

// Adjoint of the normal of a point, given the adjoints of its mirror direction and of n·v.
fn pull_back_normal(normal: vec3<f32>, to_viewer: vec3<f32>, mirror: vec3<f32>, cosine: f32) -> vec3<f32> {
    let nv = dot(normal, to_viewer);
    let along = select(dot(mirror, normal) * 2.0 + cosine, 0.0, nv < 0.0);
    return to_viewer * along + mirror * (relu(nv) * 2.0);
}
