//! Cameras as JSON: transforms.json.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lobelia_fuzz::{dataset, read};

fuzz_target!(|data: &[u8]| {
    read("transforms.json", data, |_| ());
    dataset();
});
