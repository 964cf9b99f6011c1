// Nodes and weights for a Gaussian that the horizon cuts: Gauss rules of the weight v·e^(−(v − t)²/2) on v > 0;
// `lobelia_sg::accurate::rule` with 3 nodes along the clipped direction.

// A clipped Gaussian: position of its peak, width and mass.
struct Clipped {
    // a, the distance from the unclipped center to the peak; 1/a − a = t.
    shift: f32,
    // σ = 1/√(1 + a²).
    width: f32,
    // aσ.
    share: f32,
    // Mass relative to √(2π)·σ·peak.
    mass: f32,
    // τ = t/√(t² + 4), and ((1 − τ)/2)².
    tau: f32,
    gap_squared: f32,
}

fn clip(t: f32) -> Clipped {
    let square = fma(t, t, 4.0);
    let inverse_root = inverseSqrt(square);
    let root = square * inverse_root;
    // The root without cancellation of the two roots ±a of a² + ta = 1: m = max(a, 1/a), and 1 + m² = m·root.
    let m = (root + abs(t)) * 0.5;
    let narrow = inverseSqrt(m * root);
    let wide = m * narrow;
    let tau = t * inverse_root;
    let gap = (1.0 - tau) * 0.5;
    var p = fma(0.1791278, tau, 0.5248399);
    p = fma(p, tau, 0.36396699);
    p = fma(p, tau, -0.12435211);
    p = fma(p, tau, -0.37610475);
    p = fma(p, tau, -0.39857341);
    p = fma(p, tau, -0.52792871);
    p = fma(p, tau, -0.27863366);
    let mass = fma(p, gap * gap, 1.0);
    if (t < 0.0) {
        return Clipped(m, narrow, wide, mass, tau, gap * gap);
    }
    return Clipped(1.0 / m, wide, narrow, mass, tau, gap * gap);
}

// Distances of the nodes from the peak in units of its width: Gauss–Hermite + s²P(τ).
fn node_offsets(clipped: Clipped) -> vec3<f32> {
    let tau = vec3(clipped.tau);
    var p = fma(vec3(2.4109737, -0.1183123, -4.3110822), tau, vec3(7.7177806, 3.3382652, 1.3345721));
    p = fma(p, tau, vec3(9.7692081, 5.7221413, 7.6940795));
    p = fma(p, tau, vec3(8.1328012, 4.8373994, 5.6697588));
    p = fma(p, tau, vec3(6.2772404, 3.2836375, 2.1943723));
    p = fma(p, tau, vec3(4.268551, 2.9982697, 3.5220099));
    return fma(p, vec3(clipped.gap_squared), vec3(-1.7320508075688772, 0.0, 1.7320508075688772));
}

// Fractions of the mass.
fn node_weights(clipped: Clipped) -> vec3<f32> {
    let tau = vec3(clipped.tau);
    var p = fma(vec3(0.064161864, 0.17126932, -0.23543119), tau, vec3(0.83404027, 0.0012346291, -0.8352749));
    p = fma(p, tau, vec3(1.568209, -0.47437752, -1.0938314));
    p = fma(p, tau, vec3(1.5278404, -0.69744621, -0.83039414));
    p = fma(p, tau, vec3(1.1530788, -0.59462394, -0.55845486));
    p = fma(p, tau, vec3(0.84431388, -0.47550393, -0.36880995));
    return fma(p, vec3(clipped.gap_squared), vec3(1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0));
}
