// One point × one lobe by the published formulas, and its adjoint: `lobelia_sg::published::pair`.
//
// The NDF (PhySG supp. eq. 4) is warped to incident directions (Wang et al. 2009); its product with the lobe is one SG.

// The product of the light's SG and the warped NDF, itself an SG: sharpness m, cosine c with the normal, amplitude e^x.
struct Product {
    xn: f32,
    separation: vec3<f32>,
    d: f32,
    m: f32,
    inverse_m: f32,
    x: f32,
    c: f32,
}

fn product_of(point: Point, lobe: Lobe) -> Product {
    let sharpness = lobe.sharpness;
    let xn = dot(lobe.axis, point.normal) * SHRUNK;
    let l = point.warp_sharpness;
    let separation = lobe.axis - point.mirror;
    // ξ·r − 1 for axes that are both shrunk by κ: κ²(û·r̂ − 1) − (1 − κ²).
    let d = dot(separation, separation) * (-0.5 * SHRUNK * SHRUNK) + SQUARE_SHRUNK_BY;
    let s = sharpness + l;
    let twice = sharpness * l * d * 2.0;
    let m = sqrt(max(fma(s, s, twice), s * s * 1e-12));
    let inverse_m = 1.0 / m;
    let c = fma(sharpness, xn, l * point.mirror_cosine) * inverse_m;
    return Product(xn, separation, d, m, inverse_m, twice / (m + s), c);
}

fn evaluate(point: Point, lobe: Lobe) -> Response {
    let product = product_of(point, lobe);
    let diffuse = cosine_integral(lobe.sharpness, prepared_terms(lobe), product.xn);
    let integral = cosine_integral(product.m, sharpness_terms(product.m, product.inverse_m), product.c);
    return Response(diffuse.value, vec2(decay(product.x) * integral.value, 0.0));
}

fn pull_back(point: Point, lobe: Lobe, adjoint: Response) -> PulledBack {
    let product = product_of(point, lobe);
    let diffuse = cosine_integral(lobe.sharpness, prepared_terms(lobe), product.xn);
    let integral = cosine_integral(product.m, sharpness_terms(product.m, product.inverse_m), product.c);
    let amplitude = decay(product.x);
    let value = amplitude * integral.value;

    let sharpness = lobe.sharpness;
    let l = point.warp_sharpness;
    let weight = adjoint.specular.x * amplitude;
    let c_adjoint = weight * integral.by_cosine * product.inverse_m;
    // m appears in E, in c = (…)/m, and in x = m − S.
    let m_adjoint = fma(weight, integral.by_sharpness, -(c_adjoint * product.c));
    let both = m_adjoint + adjoint.specular.x * value;
    let x_by_l1 = fma(l, product.d, -product.x) * product.inverse_m;
    let x_by_l2 = fma(sharpness, product.d, -product.x) * product.inverse_m;
    let pull = product.separation * (both * sharpness * l * product.inverse_m * (SHRUNK * SHRUNK));
    let xn_adjoint = fma(adjoint.diffuse, diffuse.by_cosine, c_adjoint * sharpness) * SHRUNK;
    let through_diffuse = fma(adjoint.diffuse, diffuse.by_sharpness, m_adjoint);
    return PulledBack(
        Response(diffuse.value, vec2(value, 0.0)),
        point.normal * xn_adjoint - pull,
        fma(both, x_by_l1, fma(c_adjoint, product.xn, through_diffuse)),
        Sums(
            lobe.axis * xn_adjoint,
            pull,
            c_adjoint * l,
            fma(both, x_by_l2, fma(c_adjoint, point.mirror_cosine, m_adjoint)),
        ),
    );
}
