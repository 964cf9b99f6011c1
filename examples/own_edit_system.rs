//! An edit of one's own: an ordinary bevy_ecs system in the slot of the shown material paints
//! stripes by height. The recovered material stays as it is, so that there is nothing to undo.
//!
//! `cargo run --release --example own_edit_system` writes three pictures under `out/examples/`.

use lobelia::prelude::*;

/// Where each texel lies.
#[derive(Resource)]
struct Places(Vec<Vec3>);

/// The edit: what a texel shows, of what was recovered and where the texel lies. What it leaves
/// alone is shown as it was recovered.
fn paint_stripes(places: Res<Places>, composition: Composition) -> SystemResult {
    composition.compose(|material| {
        let texels = material.albedo.iter_mut().zip(&mut material.sheen).zip(&places.0);
        for ((albedo, sheen), place) in texels {
            if (place.y / 0.2).floor().rem_euclid(2.0) == 0.0 {
                albedo.0 = albedo.0.lerp(Vec3::new(0.8, 0.5, 0.1), 0.9);
                sheen.0 *= 0.1;
            }
        }
        Ok(())
    })
}

fn main() -> Result<()> {
    let surface = Arc::new(Surface::new(sphere_mesh(Vec3::ZERO, 0.8)?, 256)?);
    let places = surface.atlas().position.clone();
    let mut pipeline = Pipeline::new();
    pipeline.add_plugin(&FramePlugin);
    let light = [
        LightLobe { axis: Vec3::Y, sharpness: 0.8, amplitude: Vec3::splat(0.5) },
        LightLobe { axis: Vec3::new(0.6, 0.64, 0.48), sharpness: 30.0, amplitude: Vec3::splat(4.0) },
    ];
    let albedo = vec![Vec3::new(0.15, 0.25, 0.5); places.len()];
    let material = SpecularLobe::new(Vec3::splat(0.1), 0.3);
    spawn_object(&mut pipeline.world, &surface, &albedo, &[material], &light);
    pipeline.world.insert_resource(Places(places));

    picture(&mut pipeline, "own_edit_before")?;
    // A picture is drawn tile by tile; the stripes are painted again only if what they are painted
    // on has changed.
    pipeline.swap(Phase::Compose, Slot::Material, paint_stripes.run_if(recovered_changed));
    picture(&mut pipeline, "own_edit_stripes")?;
    pipeline.swap(Phase::Compose, Slot::Material, show_recovered());
    picture(&mut pipeline, "own_edit_after")
}

fn picture(pipeline: &mut Pipeline, name: &str) -> Result<()> {
    let camera = Camera::look_at(Vec3::new(0.0, 0.6, 2.5), Vec3::ZERO, Vec3::Y, 38.0, 160, 160)?;
    let frame = resolve(&render_frame(pipeline, camera, 9)?);
    let path = format!("out/examples/{name}.png");
    save_png(&path, &frame, &Look::default())?;
    println!("{path}");
    Ok(())
}
