//! COLMAP models: the first byte chooses cameras or images, text or binary.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lobelia_fuzz::{dataset, read};

fuzz_target!(|data: &[u8]| {
    let Some((choice, data)) = data.split_first() else { return };
    let good: [&[u8]; 2] = [b"1 SIMPLE_RADIAL 8 6 10.0 4.0 3.0 0.01\n", b"1 1 0 0 0 0 0 3 1 a.hdr\n\n"];
    let (file, kind) = (usize::from(choice & 1), if choice & 2 == 0 { "txt" } else { "bin" });
    // What the other kind has left would be read first.
    let _ = std::fs::remove_dir_all(lobelia_fuzz::folder().join("sparse"));
    for (k, name) in ["cameras", "images"].into_iter().enumerate() {
        let bytes = if k == file { data } else { good[k] };
        read(&format!("sparse/0/{name}.{kind}"), bytes, |_| ());
    }
    read(&format!("sparse/0/points3D.{kind}"), b"", |_| ());
    dataset();
});
