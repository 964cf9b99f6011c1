// The accurate integrals as the loops see them: `lobelia_math::accurate::model`.

fn specular_weights(frozen: Frozen, albedo: vec3<f32>) -> mat2x3<f32> {
    return mat2x3(vec3(1.0), albedo);
}

fn no_sums() -> Sums {
    return Sums(vec2(0.0), 0.0, vec2(0.0));
}

fn add_sums(a: Sums, b: Sums) -> Sums {
    return Sums(a.normal + b.normal, a.shadowing + b.shadowing, a.ndf + b.ndf);
}

fn evaluate(point: Point, lobe: Lobe) -> Response {
    let axis = in_frame(point, lobe.axis);
    let diffuse = cosine_integral(lobe, axis.z);
    return Response(diffuse.value, specular_light(point, LocalLight(axis, lobe.sharpness)));
}

fn pull_back(point: Point, lobe: Lobe, adjoint: Response) -> PulledBack {
    let axis = in_frame(point, lobe.axis);
    let diffuse = cosine_integral(lobe, axis.z);
    let tilt = adjoint.diffuse * diffuse.by_cosine;
    let nodes = pull_back_nodes(point, LocalLight(axis, lobe.sharpness), adjoint.specular);
    let specular = vec2(nodes.powered, nodes.plain - nodes.powered) * point.scale;
    return PulledBack(
        Response(diffuse.value, specular),
        in_world(point, nodes.offset * lobe.sharpness) + point.normal * tilt,
        adjoint.diffuse * diffuse.by_sharpness - nodes.half_square,
        Sums(
            nodes.normal + tilt * axis.xy,
            -nodes.shadowing,
            vec2(nodes.value / point.sharpness - nodes.drop, nodes.value),
        ),
    );
}
