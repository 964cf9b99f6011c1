// Radiance of points, one thread each: `lobelia_sg::shading::forward`.

// Outgoing radiance, as a diffuse and a specular layer.
struct Layers {
    diffuse: vec3<f32>,
    specular: vec3<f32>,
}

@group(0) @binding(5) var<storage, read_write> shaded: array<Layers>;

@compute @workgroup_size(64)
fn shade(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if (i >= call.points) {
        return;
    }
    let surface = surfaces[i];
    if (is_missed(surface)) {
        shaded[i] = Layers(vec3(0.0), vec3(0.0));
        return;
    }
    let prepared = prepare_point(surface.normal, surface.to_viewer, call.roughness);
    let weights = specular_weights(prepared.frozen, call.albedo);
    var diffuse = vec3(0.0);
    var specular = mat2x3<f32>();
    for (var l = 0u; l < call.lobes; l++) {
        let lobe = lobes[l];
        let response = evaluate(prepared.point, lobe);
        diffuse += lobe.amplitude * (response.diffuse * reaching(i, l));
        specular[0] += lobe.amplitude * response.specular.x;
        specular[1] += lobe.amplitude * response.specular.y;
    }
    let around = around_point(i);
    let light = specular[0] * weights[0] + specular[1] * weights[1];
    shaded[i] = Layers(
        max((diffuse + around.indirect) * surface.albedo / PI, vec3(0.0)),
        max(light * around.specular, vec3(0.0)),
    );
}
