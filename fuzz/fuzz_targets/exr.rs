//! OpenEXR: layers, frames, maps.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lobelia::{codec::envmap::read_map, codec::exr::read_exr_layers, codec::exr_frame::read_frame};
use lobelia_fuzz::read;

fuzz_target!(|data: &[u8]| {
    read("a.exr", data, |path| {
        let _ = read_exr_layers(path);
        let _ = read_frame(path);
        let _ = read_map(path);
    });
});
