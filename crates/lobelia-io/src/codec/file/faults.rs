//! Faults that tests of any crate give to the files below a folder. A program has none, and pays
//! for one relaxed load a call.

use std::io::{Error, Result};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A call on a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Call {
    /// Of bytes.
    Read,
    /// Of bytes.
    Write,
    /// To the disk.
    Sync,
}

/// The outcome of a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileFault {
    /// An error with this number, at every call from the `after`-th on.
    Errno {
        /// The number.
        errno: i32,
        /// Calls that succeed.
        after: u32,
    },
    /// EINTR at every second call.
    Interrupted,
    /// No more than so many bytes at a call.
    Short(usize),
}

struct Rule {
    folder: PathBuf,
    call: Call,
    fault: FileFault,
    calls: u32,
}

/// Tests run side by side, each with a folder of its own.
static RULES: Mutex<Vec<Rule>> = Mutex::new(Vec::new());
static COUNT: AtomicUsize = AtomicUsize::new(0);

/// A fault that lasts until this is dropped.
pub struct Faulty(PathBuf);

impl Faulty {
    /// The fault of `call` on the files below `folder`.
    pub fn new(folder: &Path, call: Call, fault: FileFault) -> Self {
        COUNT.fetch_add(1, Ordering::Relaxed);
        RULES.lock().unwrap().push(Rule { folder: folder.to_owned(), call, fault, calls: 0 });
        Self(folder.to_owned())
    }
}

impl Drop for Faulty {
    fn drop(&mut self) {
        RULES.lock().unwrap().retain(|rule| rule.folder != self.0);
        COUNT.fetch_sub(1, Ordering::Relaxed);
    }
}

/// How many of `length` bytes a call may have.
pub(super) fn meet(path: &Path, call: Call, length: usize) -> Result<usize> {
    if COUNT.load(Ordering::Relaxed) == 0 {
        return Ok(length);
    }
    let mut rules = RULES.lock().unwrap();
    let Some(rule) = rules.iter_mut().find(|rule| rule.call == call && path.starts_with(&rule.folder)) else {
        return Ok(length);
    };
    rule.calls += 1;
    match rule.fault {
        FileFault::Errno { errno, after } if rule.calls > after => Err(Error::from_raw_os_error(errno)),
        FileFault::Interrupted if rule.calls % 2 == 1 => Err(std::io::ErrorKind::Interrupted.into()),
        FileFault::Short(most) => Ok(length.min(most)),
        FileFault::Errno { .. } | FileFault::Interrupted => Ok(length),
    }
}

#[cfg(test)]
mod tests {
    //! Every codec on a disk that gives few bytes at a time, is interrupted, or fails: the same
    //! bytes and values, or one error and nothing left.

    use super::{Call, Faulty, FileFault};
    use crate::codec::file::{read_parts, read_text, write_bytes};
    use crate::codec::image::{Gamma, Orientation, read_image};
    use crate::codec::npy::{NpyConvention, read_lobes, write_lobes};
    use crate::codec::{
        envmap::read_map, exr_frame::read_frame, exr_frame::write_frame, gltf::export::write_glb,
        gltf::import::read_mesh, png_file::write_rgb8, test_data::frame, test_data::hdr_bytes,
        test_data::temporary,
    };
    use glam::Vec3;
    use image::{Rgb, RgbImage};
    use lobelia_geometry::{Error, Result, mesh::primitive::box_mesh};
    use lobelia_world::light::LightLobe;
    use std::path::Path;

    /// The numbers of errors: EIO, ENOSPC.
    const ERRORS: [i32; 2] = [5, 28];

    type Writer = (&'static str, fn(&Path) -> Result<()>);
    type Reader = (&'static str, fn(&Path), fn(&Path) -> Result<String>);

    fn picture() -> RgbImage {
        RgbImage::from_fn(19, 13, |x, y| Rgb([x as u8 * 13, y as u8 * 19, (x * y) as u8]))
    }

    fn cube() -> lobelia_geometry::mesh::triangles::Mesh {
        box_mesh(Vec3::ZERO, Vec3::ONE).unwrap()
    }

    const WRITERS: [Writer; 4] = [
        ("a.png", |path| write_rgb8(path, &picture())),
        ("a.exr", |path| write_frame(path, &frame(9, 7))),
        ("a.glb", |path| write_glb(path, &cube(), None)),
        ("a.txt", |path| write_bytes(path, &[7; 20_000])),
    ];

    /// The value that a reader finds, in a form that can be compared.
    fn shown(value: impl std::fmt::Debug) -> Result<String> {
        Ok(format!("{value:?}"))
    }

    fn save(path: &Path, format: image::ImageFormat) {
        picture().save_with_format(path, format).unwrap();
    }

    fn write_tiff(path: &Path) {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let mut encoder = tiff::encoder::TiffEncoder::new(&mut bytes).unwrap();
        encoder.write_image::<tiff::encoder::colortype::RGB8>(19, 13, picture().as_raw()).unwrap();
        std::fs::write(path, bytes.into_inner()).unwrap();
    }

    const READERS: [Reader; 8] = [
        ("a.png", |path| save(path, image::ImageFormat::Png), read_any),
        ("a.jpg", |path| save(path, image::ImageFormat::Jpeg), read_any),
        ("a.tif", write_tiff, read_any),
        ("a.webp", |path| save(path, image::ImageFormat::WebP), read_any),
        (
            "b.hdr",
            |path| std::fs::write(path, hdr_bytes(8, 4, &[Vec3::new(0.5, 0.25, 1.0); 32])).unwrap(),
            |path| shown((read_any(path)?, read_map(path)?)),
        ),
        (
            "f.exr",
            |path| write_frame(path, &frame(9, 7)).unwrap(),
            |path| shown((read_any(path)?, read_frame(path)?)),
        ),
        (
            "a.npy",
            |path| write_lobes(path, &LightLobe::even(7), NpyConvention::Lobelia).unwrap(),
            |path| shown(read_lobes(path, NpyConvention::Lobelia)?),
        ),
        ("a.glb", |path| write_glb(path, &cube(), None).unwrap(), |path| shown(read_mesh(path)?)),
    ];

    fn read_any(path: &Path) -> Result<String> {
        shown(read_image(path, Gamma::Srgb, Orientation::AsStored)?.image)
    }

    fn names_in(folder: &Path) -> usize {
        std::fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn few_bytes_at_a_time_and_interruptions_write_the_same_bytes() {
        for (name, write) in WRITERS {
            let (plain, odd) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
            write(&plain.path().join(name)).unwrap();
            let bytes = std::fs::read(plain.path().join(name)).unwrap();
            for fault in [FileFault::Short(1), FileFault::Short(3), FileFault::Interrupted] {
                let _faulty = Faulty::new(odd.path(), Call::Write, fault);
                write(&odd.path().join(name)).unwrap_or_else(|error| panic!("{name}, {fault:?}: {error}"));
                assert!(std::fs::read(odd.path().join(name)).unwrap() == bytes, "{name}, {fault:?}");
            }
        }
    }

    #[test]
    fn a_disk_that_fails_leaves_the_old_file_and_nothing_else() {
        for (name, write) in WRITERS {
            for (call, after) in [(Call::Write, 0), (Call::Write, 1), (Call::Sync, 0)] {
                for errno in ERRORS {
                    let (folder, path) = temporary(name);
                    std::fs::write(&path, b"old").unwrap();
                    let faulty = Faulty::new(folder.path(), call, FileFault::Errno { errno, after });
                    let written = write(&path);
                    drop(faulty);
                    let Err(error) = written else {
                        // A small file is written at once.
                        assert!(call == Call::Write && after > 0, "{name}: {call:?} {errno} was not met");
                        continue;
                    };
                    let said = error.to_string();
                    assert!(said.contains(name) && error.exit_code() == 1, "{said}");
                    assert!(matches!(error, Error::Io { .. } | Error::Run { .. }), "{error:?}");
                    assert_eq!(std::fs::read(&path).unwrap(), b"old", "{name}");
                    assert_eq!(names_in(folder.path()), 1, "{name}: an unfinished file is left");
                }
            }
        }
    }

    #[test]
    fn few_bytes_at_a_time_and_interruptions_read_the_same_values() {
        for (name, write, read) in READERS {
            let (folder, path) = temporary(name);
            write(&path);
            let whole = read(&path).unwrap();
            for fault in [FileFault::Short(1), FileFault::Short(5), FileFault::Interrupted] {
                let _faulty = Faulty::new(folder.path(), Call::Read, fault);
                let found = read(&path).unwrap_or_else(|error| panic!("{name}, {fault:?}: {error}"));
                assert!(found == whole, "{name}, {fault:?}");
            }
        }
    }

    #[test]
    fn a_disk_that_fails_while_it_is_read_is_one_error_that_names_the_file() {
        for (name, write, read) in READERS {
            let (folder, path) = temporary(name);
            write(&path);
            for after in [0, 1] {
                let _faulty = Faulty::new(folder.path(), Call::Read, FileFault::Errno { errno: 5, after });
                match read(&path) {
                    Err(error) => assert!(error.to_string().contains(name), "{error}"),
                    // A small file is read at once.
                    Ok(_) => assert!(after > 0, "{name}"),
                }
            }
        }
    }

    #[test]
    fn texts_and_parts_are_whole_in_spite_of_interruptions() {
        let (folder, path) = temporary("a.ron");
        let text = "grün ".repeat(300);
        std::fs::write(&path, &text).unwrap();
        for fault in [FileFault::Short(1), FileFault::Interrupted] {
            let _faulty = Faulty::new(folder.path(), Call::Read, fault);
            assert_eq!(read_text(&path, 1 << 20, |_| String::new()).unwrap(), text);
            let mut parts = Vec::new();
            read_parts(&path, |part| parts.extend_from_slice(part)).unwrap();
            assert_eq!(parts, text.as_bytes());
        }
    }
}
