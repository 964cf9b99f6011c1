// The accurate integrals as the loops see them: `lobelia_sg::accurate::model`.

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
    let light = LocalLight(in_frame(point, lobe.axis), lobe.sharpness);
    let diffuse = cosine_integral(lobe, light.axis.z);
    if (smoothness(point, light) > 0.0) {
        return Response(diffuse.value, smooth_light(point, light, diffuse.value));
    }
    return Response(diffuse.value, specular_light(point, light));
}

// The specular part by nodes around the peak.
fn pull_back_around_peak(point: Point, light: LocalLight, adjoint: vec2<f32>) -> SpecularBack {
    let nodes = pull_back_nodes(point, light, adjoint);
    return SpecularBack(
        vec2(nodes.powered, nodes.plain - nodes.powered) * point.scale,
        in_world(point, nodes.offset * light.sharpness),
        -nodes.half_square,
        Sums(nodes.normal, -nodes.shadowing, vec2(nodes.value / point.sharpness - nodes.drop, nodes.value)),
    );
}

fn pull_back(point: Point, lobe: Lobe, adjoint: Response) -> PulledBack {
    let light = LocalLight(in_frame(point, lobe.axis), lobe.sharpness);
    let diffuse = cosine_integral(lobe, light.axis.z);
    let tilt = adjoint.diffuse * diffuse.by_cosine;
    var specular: SpecularBack;
    if (smoothness(point, light) > 0.0) {
        specular = pull_back_smooth(point, light, diffuse, adjoint.specular);
    } else {
        specular = pull_back_around_peak(point, light, adjoint.specular);
    }
    var sums = specular.sums;
    sums.normal += tilt * light.axis.xy;
    return PulledBack(
        Response(diffuse.value, specular.light),
        specular.axis + point.normal * tilt,
        adjoint.diffuse * diffuse.by_sharpness + specular.sharpness,
        sums,
    );
}
