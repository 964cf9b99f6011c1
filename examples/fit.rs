//! Shape, light and material of an object from a folder of photographs with cameras. Without a
//! folder it photographs a ball itself, whose shape it knows.
//!
//! `cargo run --release --example fit -- FOLDER` writes pictures and a scene to `out/examples/fit`.

use lobelia::prelude::*;
use std::ops::ControlFlow;

fn main() -> Result<()> {
    let options = ReconstructOptions { progress: Arc::new(tell), ..ReconstructOptions::default() };
    let (capture, mut object) = if let Some(folder) = std::env::args().nth(1) {
        let capture = Capture::read(folder)?.hold_out(8);
        let object = Object::reconstruct(&capture.train(), &options)?;
        (capture, object)
    } else {
        let capture = photographs()?.hold_out(8);
        let options = ReconstructOptions { texture_size: 64, ..options };
        let object = Object::fit(&sphere_mesh(Vec3::ZERO, 0.8)?, &capture.train(), &options)?;
        (capture, object)
    };
    for view in capture.test().iter() {
        let path = format!("out/examples/fit/{}.png", view.name);
        save_png(&path, &object.render(view.camera)?, &Look::default())?;
    }
    object.save("out/examples/fit")
}

/// Called after each step; `Break` would end the fit and keep what it has.
fn tell(at: &Step) -> ControlFlow<()> {
    if at.step.is_multiple_of(200) {
        println!("{} {}: {:.1} dB", at.pass, at.step, at.fit.sums.psnr());
    }
    ControlFlow::Continue(())
}

fn photographs() -> Result<Capture> {
    let mut ball = Object::open(concat!(env!("CARGO_MANIFEST_DIR"), "/examples/studio.ron"))?;
    let mut view = |(i, camera)| -> Result<ViewRecord> {
        let view = ViewRecord::of_camera(format!("{i:02}"), Split::Train, camera);
        Ok(view.with_frame(ball.render(camera)?))
    };
    let cameras = Camera::around(16, 2.8, 38.0, 48)?.into_iter().enumerate();
    Ok(Capture::from(cameras.map(&mut view).collect::<Result<Vec<_>>>()?))
}
