// The published formulas as the loops see them: `lobelia_sg::published::model`.

fn specular_weights(frozen: Frozen, albedo: vec3<f32>) -> mat2x3<f32> {
    return mat2x3(vec3(frozen.constant) + frozen.slope * albedo, vec3(0.0));
}

fn no_sums() -> Sums {
    return Sums(vec3(0.0), vec3(0.0), 0.0, 0.0);
}

fn add_sums(a: Sums, b: Sums) -> Sums {
    return Sums(
        a.normal + b.normal,
        a.mirror + b.mirror,
        a.mirror_cosine + b.mirror_cosine,
        a.warp_sharpness + b.warp_sharpness,
    );
}

fn pull_back_point(prepared: Prepared, sums: Sums, end: PointEnd) -> PointBack {
    let frozen = prepared.frozen;
    let light = end.specular_light[0];
    let chain = vec3(dot(light, vec3(1.0)), dot(light, end.albedo), sums.warp_sharpness);
    let cosine = dot(chain, frozen.by_cosine) + sums.mirror_cosine;
    let through_view = pull_back_normal(end.normal, end.to_viewer, sums.mirror, cosine);
    return PointBack(sums.normal + through_view, light * frozen.slope, dot(chain, frozen.by_roughness));
}
