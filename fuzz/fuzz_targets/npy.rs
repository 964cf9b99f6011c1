//! Arrays of lobes.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lobelia::codec::npy::{NpyConvention, read_lobes};
use lobelia_fuzz::read;

fuzz_target!(|data: &[u8]| {
    read("light.npy", data, |path| drop(read_lobes(path, NpyConvention::Lobelia)));
});
