//! A pass of one's own in a run of a scene file: it writes how far the surface is from the camera
//! of each view. The run knows its files, says it in `run.json`, and goes on after it.
//!
//! `cargo run --release --example own_pass` writes to `out/examples/own_pass`.

use lobelia::pass::{OwnPass, RunOptions, run};
use lobelia::prelude::*;
use lobelia::scene::{LoadOptions, Pass, load};
use std::path::Path;

/// Renders a view, and writes its distances, the nearest white.
fn depth(object: &mut Object, folder: &Path) -> Result<()> {
    let cameras = object.pipeline().world.query::<&Camera>();
    let camera = { cameras }.iter(&object.pipeline().world).next().copied();
    let Some(camera) = camera else { return Ok(()) };
    let mut frame = object.render(camera)?;
    let hits = || frame.depth.iter().copied().filter(|depth| *depth > 0.0);
    let (near, far) = (hits().fold(f32::INFINITY, f32::min), hits().fold(0.0, f32::max));
    let gray = |depth: &f32| if *depth > 0.0 { (far - depth) / (far - near) } else { 0.0 };
    frame.color = frame.depth.iter().map(|depth| Vec3::splat(gray(depth))).collect();
    save_png(folder.join("depth.png"), &frame, &Look::default())
}

fn main() -> Result<()> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/quickstart.ron");
    let mut loaded = load(Path::new(path), &LoadOptions::default())?;
    loaded.scene.passes.retain(|pass| matches!(pass, Pass::Fit(_)));
    let files = vec!["depth.png".to_owned()];
    let own = vec![OwnPass { name: "depth".to_owned(), files, work: Arc::new(depth) }];
    let out = "out/examples/own_pass".into();
    let options = RunOptions { out, force: true, own, ..RunOptions::default() };
    run(&loaded, &options, Arc::new(lobelia::progress::Silent))
}
