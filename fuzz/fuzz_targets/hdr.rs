//! Radiance HDR: maps and photographs.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lobelia::codec::envmap::read_map;
use lobelia::codec::image::{Gamma, Orientation, read_image};
use lobelia_fuzz::read;

fuzz_target!(|data: &[u8]| {
    read("a.hdr", data, |path| {
        let _ = read_map(path);
        let _ = read_image(path, Gamma::Srgb, Orientation::AsStored);
    });
});
