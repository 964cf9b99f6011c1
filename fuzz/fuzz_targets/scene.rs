//! Scene files.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lobelia::scene::{LoadOptions, load};
use lobelia_fuzz::read;

fuzz_target!(|data: &[u8]| {
    read("scene.ron", data, |path| drop(load(path, &LoadOptions::default())));
});
