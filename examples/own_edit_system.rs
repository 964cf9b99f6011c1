//! An edit of one's own: an ordinary bevy_ecs system in the slot of the shown material paints
//! stripes by height. The recovered material stays as it is, so that there is nothing to undo.
//!
//! `cargo run --release --example own_edit_system` writes three pictures to `out/examples`.

use lobelia::{ecs::*, prelude::*};

/// Where each texel lies.
#[derive(Resource)]
struct Places(Vec<Vec3>);

/// The edit: what a texel shows, of what was recovered and where the texel lies.
fn paint_stripes(places: Res<Places>, composition: Composition) -> SystemResult {
    composition.compose(|material| {
        for (texel, place) in material.diffuse.iter_mut().zip(&places.0) {
            if (place.y / 0.2).floor().rem_euclid(2.0) == 0.0 {
                texel.albedo = texel.albedo.lerp(Vec3::new(0.8, 0.5, 0.1), 0.9);
                texel.sheen *= 0.1;
            }
        }
        Ok(())
    })
}

fn main() -> Result<()> {
    let mut object = Object::open(concat!(env!("CARGO_MANIFEST_DIR"), "/examples/studio.ron"))?;
    let places = Places(object.surface().atlas().position.clone());
    object.pipeline().world.insert_resource(places);
    picture(&mut object, "own_edit_before")?;
    // The stripes are painted again only if what they are painted on has changed.
    object.pipeline().swap(Phase::Compose, Slot::Material, paint_stripes.run_if(recovered_changed));
    picture(&mut object, "own_edit_stripes")?;
    object.pipeline().swap(Phase::Compose, Slot::Material, show_recovered());
    picture(&mut object, "own_edit_after")
}

fn picture(object: &mut Object, name: &str) -> Result<()> {
    let camera = Camera::look_at(Vec3::new(0.0, 0.6, 2.5), Vec3::ZERO, Vec3::Y, 38.0, 160, 160)?;
    let path = format!("out/examples/{name}.png");
    println!("{path}");
    save_png(&path, &object.render(camera)?, &Look::default())
}
