//! A scene file from a program: what it says is changed, and its passes run, with a line for each.
//!
//! `cargo run --release --example run_scene -- SCENE.ron OUT`

use lobelia::pass::{RunOptions, run};
use lobelia::prelude::*;
use lobelia::scene::{LoadOptions, Pass, load};
use std::path::Path;

/// Says which pass is at work, and its results.
struct Lines;

impl Progress for Lines {
    fn pass(&self, name: &str, number: usize, count: usize) {
        println!("{number} of {count}: {name}");
    }

    fn print(&self, text: &str) {
        println!("    {text}");
    }
}

fn main() -> Result<()> {
    let quickstart = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/quickstart.ron");
    let mut arguments = std::env::args().skip(1);
    let scene = arguments.next().unwrap_or_else(|| quickstart.to_owned());
    let out = arguments.next().unwrap_or_else(|| "out/examples/run_scene".to_owned());
    let mut loaded = load(Path::new(&scene), &LoadOptions::default())?;
    for pass in &mut loaded.scene.passes {
        if let Pass::Fit(fit) = pass {
            fit.steps /= 4;
        }
    }
    let options = RunOptions { out: out.into(), force: true, ..RunOptions::default() };
    run(&loaded, &options, Arc::new(Lines))
}
