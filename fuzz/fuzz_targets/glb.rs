//! Meshes and materials.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lobelia::{codec::gltf::import::read_mesh, codec::gltf::material::read_material};
use lobelia_fuzz::read;

fuzz_target!(|data: &[u8]| {
    read("mesh.glb", data, |path| {
        let _ = read_mesh(path);
        let _ = read_material(path);
    });
});
