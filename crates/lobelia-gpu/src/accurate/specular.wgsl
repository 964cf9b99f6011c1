// The specular integral of one light SG over an SG of half vectors, by 3 × 2 nodes: `lobelia_sg::accurate::specular` and its adjoint,
// `lobelia_sg::accurate::adjoint`.
//
// ∫ F·G₁(n·ω)·G₁(n·v)·(n·ω)·(v·h) · (L/2π)e^{L(h·n − 1)} · e^{λ(ω·ξ − 1)} dh (PhySG supp. eqs. 1–7) with ω = 2(v·h)h − v, in
// Lambert's equal-area chart around the normal, |X|² = 2(1 − h·n).

// Gauss–Hermite weight of the nodes at ±1 across the clipped direction, times e^½.
const ACROSS_WEIGHT = 0.8243606353500641;

// Nodes at the same position along the clipped direction.
struct Row {
    base: vec2<f32>,
    exponent: f32,
    weight: f32,
}

fn row_of(placement: Placement, offset: f32, weight: f32) -> Row {
    let clipped = placement.clipped;
    let along = clipped.width * offset;
    // The weight that the rule assumes is divided out: v and e^(−u²/2), both relative to the peak.
    return Row(
        offset * placement.along + placement.peak,
        along * fma(along, 0.5, clipped.shift),
        placement.weight * weight * ACROSS_WEIGHT / fma(clipped.share, offset, 1.0),
    );
}

// The integrand at one node, times the node's weight.
struct Node {
    // ω − ξ, and |ω − ξ|²/2.
    offset: vec3<f32>,
    half_square: f32,
    // ω, whose part along the normal is 0 below the horizon.
    direction: vec3<f32>,
    // h along tangent and bitangent.
    half: vec2<f32>,
    // 1 − h·n.
    drop: f32,
    // 1/(n·ω(1 − k) + k).
    shadowing: f32,
    // The integrand divided by n·ω, without the factors of the point and without F.
    over_cosine: f32,
    // 2^(−(5.55473 v·h + 6.8316) v·h).
    fresnel: f32,
}

fn node_at(point: Point, light: LocalLight, row: Row, x: vec2<f32>) -> Node {
    let drop = dot(x, x) * 0.5;
    let half = sqrt(1.0 - 0.5 * min(drop, 1.0)) * x;
    let up = 1.0 - drop;
    let view_half = relu(fma(point.view.x, half.x, point.view.y * up));
    let direction = 2.0 * view_half * vec3(half, up) - vec3(point.view.x, 0.0, point.view.y);
    let offset = direction - light.axis;
    let half_square = dot(offset, offset) * 0.5;
    let exponent = fma(-point.sharpness, drop, row.exponent - light.sharpness * half_square);
    let cosine = relu(direction.z);
    let shadowing = 1.0 / fma(cosine, 1.0 - point.k, point.k);
    let over_cosine = fading_exp(exponent) * view_half * shadowing * row.weight;
    let above = vec3(direction.xy, cosine);
    return Node(offset, half_square, above, half, drop, shadowing, over_cosine, fresnel_power(view_half));
}

// The specular light for specular albedo s, `constant + slope·s`.
fn specular_light(point: Point, light: LocalLight) -> vec2<f32> {
    let placement = place(point, light);
    let offsets = node_offsets(placement.clipped);
    let weights = node_weights(placement.clipped);
    var powered = 0.0;
    var plain = 0.0;
    for (var n = 0u; n < 6u; n++) {
        let row = row_of(placement, offsets[n / 2u], weights[n / 2u]);
        let x = row.base + select(-placement.across, placement.across, n % 2u == 1u);
        let node = node_at(point, light, row, x);
        let value = node.over_cosine * node.direction.z;
        plain += value;
        powered = fma(value, node.fresnel, powered);
    }
    return vec2(powered, plain - powered) * point.scale;
}

// Sums over nodes for the adjoint; each node is weighted by its share of the objective.
struct NodeSums {
    powered: f32,
    plain: f32,
    value: f32,
    offset: vec3<f32>,
    half_square: f32,
    normal: vec2<f32>,
    shadowing: f32,
    drop: f32,
}

// Adds a node, given the adjoints of the light with the Fresnel power and without it.
fn add_node(sums: NodeSums, node: Node, point: Point, weights: vec2<f32>) -> NodeSums {
    let light = node.over_cosine * node.direction.z;
    let over_cosine = node.over_cosine * fma(weights.x, node.fresnel, weights.y);
    let value = over_cosine * node.direction.z;
    // Below the horizon the derivatives are 0; `value` is 0 there because of its cosine.
    let turn = select(0.0, over_cosine * node.shadowing * point.k, node.direction.z > 0.0);
    return NodeSums(
        fma(light, node.fresnel, sums.powered),
        sums.plain + light,
        sums.value + value,
        sums.offset + value * node.offset,
        fma(value, node.half_square, sums.half_square),
        sums.normal + value * point.sharpness * node.half + turn * node.direction.xy,
        fma(value * node.shadowing, 1.0 - node.direction.z, sums.shadowing),
        fma(value, node.drop, sums.drop),
    );
}

// The sums of all nodes, given the adjoints of constant and slope. Nodes and weights are held fixed in world space.
fn pull_back_nodes(point: Point, light: LocalLight, adjoint: vec2<f32>) -> NodeSums {
    let placement = place(point, light);
    let offsets = node_offsets(placement.clipped);
    let weights = node_weights(placement.clipped);
    let shares = vec2(adjoint.x - adjoint.y, adjoint.y) * point.scale;
    var sums = NodeSums(0.0, 0.0, 0.0, vec3(0.0), 0.0, vec2(0.0), 0.0, 0.0);
    for (var n = 0u; n < 6u; n++) {
        let row = row_of(placement, offsets[n / 2u], weights[n / 2u]);
        let x = row.base + select(-placement.across, placement.across, n % 2u == 1u);
        sums = add_node(sums, node_at(point, light, row, x), point, shares);
    }
    return sums;
}
