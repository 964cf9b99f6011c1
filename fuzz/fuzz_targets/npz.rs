//! Archives of matrices.

#![no_main]

use libfuzzer_sys::fuzz_target;
use lobelia::codec::npy::Npz;
use lobelia_fuzz::read;

fuzz_target!(|data: &[u8]| {
    read("cameras.npz", data, |path| {
        let Ok(mut archive) = Npz::open(path, |_| String::new()) else { return };
        for name in archive.names() {
            let _ = archive.matrix(&name);
        }
    });
});
