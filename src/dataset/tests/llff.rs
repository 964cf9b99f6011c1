//! The layout of LLFF and NeRD.

use super::*;
use crate::codec::test_data::npy_matrix;

/// At (0.1, 0.2, 3), looking along −Z with +Y up: the axes are down, right and backward. Written for 12×8 pixels, twice [`SIZE`].
const ROW: [f64; 17] =
    [0.0, 1.0, 0.0, 0.1, 8.0, -1.0, 0.0, 0.0, 0.2, 12.0, 0.0, 0.0, 1.0, 3.0, 20.0, 1.0, 9.0];

struct Llff {
    dir: TempDir,
    rows: Vec<[f64; 17]>,
}

impl Llff {
    fn new(views: usize) -> Self {
        let set = Self { dir: tempfile::tempdir().unwrap(), rows: vec![ROW; views] };
        for n in 0..views {
            write_photograph(&set.path(&format!("images/DSC_{:04}.jpg", n + 7)), 1);
            write_mask(&set.path(&format!("masks/DSC_{:04}.png", n + 7)));
        }
        set.write();
        set
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn write(&self) {
        let bytes = npy_matrix(self.rows.len(), 17, self.rows.as_flattened());
        fs::write(self.path("poses_bounds.npy"), bytes).unwrap();
    }

    fn error(&self) -> String {
        input_error(read_all(self.dir.path()))
    }

    /// The error with another number in the second row.
    fn error_with(&mut self, i: usize, value: f64) -> String {
        self.rows[1] = ROW;
        self.rows[1][i] = value;
        self.write();
        self.error()
    }
}

#[test]
fn axes_are_turned_and_focal_lengths_scaled() {
    let set = Llff::new(9);
    let dataset = read_all(set.dir.path()).unwrap();
    assert_eq!((dataset.layout, dataset.views.len()), (Layout::Llff, 9));
    let view = &dataset.views[8];
    let camera = view.camera;
    assert_eq!((view.name.as_str(), camera.focal, camera.center), ("DSC_0015", [10.0; 2], [3.0, 2.0]));
    assert_eq!(camera.pixel_center, 0.5);
    assert!(camera.position().distance(Vec3::new(0.1, 0.2, 3.0)) < 1e-6);
    assert!(camera.ray(3.0, 2.0).direction.distance(Vec3::NEG_Z) < 1e-6);
    let (x, y, _) = camera.project(Vec3::new(0.4, 0.6, 0.0)).unwrap();
    assert!(x > 3.0 && y < 2.0, "world +X is right, +Y up: ({x}, {y})");
    assert_eq!(mask_of(view).coverage[3..5], [1.0, 0.0]);
    assert_eq!(names(&read_split(set.dir.path(), Split::Test).unwrap()), ["DSC_0007", "DSC_0015"]);
}

#[test]
fn smaller_photographs_are_found_and_masks_are_optional() {
    let set = Llff::new(2);
    fs::rename(set.path("images"), set.path("images_2")).unwrap();
    fs::remove_dir_all(set.path("masks")).unwrap();
    let views = read_all(set.dir.path()).unwrap().views;
    assert!(views.len() == 2 && views.iter().all(|view| view.mask.is_none()));
    fs::remove_dir_all(set.path("images_2")).unwrap();
    assert_says(&set.error(), &["no photographs: looked for images in images, images_1"]);
}

#[test]
fn rows_that_are_no_cameras_are_named() {
    let mut set = Llff::new(2);
    assert_says(&set.error_with(1, f64::NAN), &["poses_bounds.npy, row 1", "the pose has a NaN"]);
    assert_says(&set.error_with(1, 0.0), &["row 1", "the pose is singular"]);
    assert_says(&set.error_with(1, 2.0), &["row 1", "the pose is not rigid", "down, right, backward"]);
    assert_says(&set.error_with(1, -1.0), &["row 1", "the pose is a reflection"]);
    assert_says(&set.error_with(4, 0.0), &["row 1", "image size 12×0"]);
    assert_says(&set.error_with(9, 11.5), &["row 1", "image size 11.5×8"]);
    assert_says(&set.error_with(9, 9.0), &["DSC_0008.jpg", "6×4", "9×8"]);
    assert_says(&set.error_with(14, 0.0), &["row 1", "focal length is 0"]);
    assert_says(&set.error_with(14, f64::NAN), &["row 1", "focal length is NaN"]);
    let file = set.path("poses_bounds.npy");
    fs::write(&file, npy_matrix(2, 16, &[0.0; 32])).unwrap();
    assert_says(&set.error(), &["the array has 16 columns, not 17"]);
    let bytes = npy_matrix(2, 17, [ROW, ROW].as_flattened());
    fs::write(&file, &bytes[..bytes.len() - 8]).unwrap();
    assert_says(&set.error(), &["poses_bounds.npy", "truncated"]);
    fs::write(&file, "text").unwrap();
    assert_says(&set.error(), &["poses_bounds.npy", "not a NumPy"]);
}

#[test]
fn counts_that_differ_say_which_photograph() {
    let set = Llff::new(5);
    fs::remove_file(set.path("images/DSC_0009.jpg")).unwrap();
    let text = set.error();
    assert_says(&text, &["5 cameras, but 4 photographs", "With a mask and no photograph: DSC_0009"]);
    fs::remove_dir_all(set.path("masks")).unwrap();
    assert_says(&set.error(), &["Missing in the sequence: DSC_0009"]);
    let set = Llff::new(5);
    write_photograph(&set.path("images/DSC_0001.jpg"), 1);
    assert_says(&set.error(), &["5 cameras, but 6 photographs", "Without a mask: DSC_0001.jpg"]);
    // Hidden files of file managers are no photographs.
    fs::rename(set.path("images/DSC_0001.jpg"), set.path("images/._DSC_0001.jpg")).unwrap();
    assert_eq!(read_all(set.dir.path()).unwrap().views.len(), 5);
    fs::remove_file(set.path("masks/DSC_0010.png")).unwrap();
    assert_says(&set.error(), &["the mask of `DSC_0010.jpg` is missing"]);
}

/// A sparse file takes no room on the disk; read whole, it would take that in memory.
#[test]
fn absurd_counts_are_refused_before_values_are_read() {
    let set = Llff::new(3);
    let rows = 30_000_000_u64;
    let head = npy_matrix(0, 17, &[]);
    let text = String::from_utf8_lossy(&head[10..]).replace("(0, 17)", &format!("({rows}, 17)"));
    let length = u16::try_from(text.len()).unwrap().to_le_bytes();
    let path = set.path("poses_bounds.npy");
    fs::write(&path, [&head[..8], &length, text.as_bytes()].concat()).unwrap();
    let bytes = (10 + text.len()) as u64 + 136 * rows;
    fs::File::options().write(true).open(&path).unwrap().set_len(bytes).unwrap();
    assert_says(
        &set.error(),
        &["poses_bounds.npy", "room for 30000000 cameras", "3 photographs in", "images"],
    );
}

#[test]
fn photographs_of_a_format_that_is_not_read_say_so() {
    let set = Llff::new(3);
    fs::remove_dir_all(set.path("images")).unwrap();
    fs::create_dir(set.path("images")).unwrap();
    for name in ["b.avif", "a.avif"] {
        fs::write(set.path("images").join(name), b"\0\0\0\x18ftypavif\0\0\0\0").unwrap();
    }
    assert_says(&set.error(), &["images/a.avif: this is an AVIF, which is not read", "avifdec"]);
}
