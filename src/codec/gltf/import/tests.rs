//! Good, odd and bad glTF files, all made here.

use super::*;
use serde_json::{Value, json};
use std::path::PathBuf;

/// A `.gltf` document under construction; its one buffer becomes a data URI unless told otherwise.
struct Document {
    root: Value,
    bytes: Vec<u8>,
}

impl Document {
    fn new() -> Self {
        let root = json!({
            "asset": {"version": "2.0"}, "buffers": [], "bufferViews": [], "accessors": [],
            "meshes": [{"primitives": []}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}],
        });
        Self { root, bytes: Vec::new() }
    }

    fn push(&mut self, list: &str, value: Value) -> usize {
        let items = self.root[list].as_array_mut().unwrap();
        items.push(value);
        items.len() - 1
    }

    fn accessor(&mut self, bytes: &[u8], component: u32, kind: &str, count: usize) -> usize {
        let view = self.push(
            "bufferViews",
            json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len()}),
        );
        self.bytes.extend(bytes);
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": component, "count": count, "type": kind}),
        )
    }

    fn floats(&mut self, values: &[f32], width: usize) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.accessor(&bytes, 5126, ["", "SCALAR", "VEC2", "VEC3"][width], values.len() / width)
    }

    fn primitive(&mut self, primitive: Value) {
        self.root["meshes"][0]["primitives"].as_array_mut().unwrap().push(primitive);
    }

    /// A unit right triangle in z = 0.
    fn with_triangle(positions: [f32; 9]) -> Self {
        let mut document = Self::new();
        let accessor = document.floats(&positions, 3);
        document.primitive(json!({"attributes": {"POSITION": accessor}}));
        document
    }

    fn triangle() -> Self {
        Self::with_triangle([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    }

    fn text(&self) -> String {
        let mut root = self.root.clone();
        if root["buffers"].as_array().unwrap().is_empty() {
            let uri = format!("data:application/octet-stream;base64,{}", base64(&self.bytes));
            root["buffers"] = json!([{"byteLength": self.bytes.len(), "uri": uri}]);
        }
        root.to_string()
    }

    fn read(&self) -> Result<(Mesh, MeshReport)> {
        read_bytes(self.text().as_bytes())
    }

    fn mesh(&self) -> Mesh {
        self.read().unwrap().0
    }
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let group = |chunk: &[u8]| {
        let bits = (0..3).fold(0u32, |bits, k| bits << 8 | u32::from(*chunk.get(k).unwrap_or(&0)));
        (0..4).map(move |k| (bits >> (18 - 6 * k) & 63) as usize).collect::<Vec<_>>()
    };
    bytes
        .chunks(3)
        .flat_map(|chunk| group(chunk).into_iter().enumerate().map(move |(k, d)| (k <= chunk.len(), d)))
        .map(|(used, digit)| if used { DIGITS[digit] as char } else { '=' })
        .collect()
}

fn read_bytes(bytes: &[u8]) -> Result<(Mesh, MeshReport)> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.gltf");
    std::fs::write(&path, bytes).unwrap();
    read_mesh_with_report(&path)
}

/// The error names the file and says `words`.
fn assert_refused(result: Result<(Mesh, MeshReport)>, words: &str) {
    let error = result.expect_err(words);
    assert!(matches!(error, Error::Input { .. }), "{error:?}");
    let message = error.to_string();
    assert!(message.contains(words), "{message:?} does not say {words:?}");
}

#[test]
fn a_bare_triangle_gets_smooth_normals() {
    let (mesh, report) = Document::triangle().read().unwrap();
    assert_eq!(mesh.positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
    assert_eq!(mesh.normals, [Vec3::Z; 3]);
    assert_eq!((mesh.uvs, mesh.triangles), (None, vec![[0, 1, 2]]));
    assert_eq!(report, MeshReport { primitives: 1, computed_normals: 3, ..MeshReport::default() });
    assert_eq!(report.notes().len(), 1);
}

#[test]
fn strips_fans_and_skipped_modes() {
    for (mode, expected) in [
        (4, vec![[0, 1, 2]]),
        (5, vec![[0, 1, 2], [1, 3, 2], [2, 3, 4]]),
        (6, vec![[1, 2, 0], [2, 3, 0], [3, 4, 0]]),
    ] {
        let mut document = Document::new();
        let points = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.1, 1.0, 1.0, 0.3, 0.5, 2.0, 0.7];
        let accessor = document.floats(&points, 3);
        for mode in [0, 1, mode, 3] {
            document.primitive(json!({"attributes": {"POSITION": accessor}, "mode": mode}));
        }
        let (mesh, report) = document.read().unwrap();
        assert_eq!(mesh.triangles, expected);
        assert_eq!((report.primitives, report.skipped_primitives), (1, 3));
    }
}

#[test]
fn indices_of_every_width_and_degenerate_triangles() {
    for component in [5121u32, 5123, 5125] {
        let size = [1, 0, 2, 0, 4][(component - 5121) as usize];
        let bytes: Vec<u8> =
            [2u32, 0, 1, 1, 1, 0].iter().flat_map(|i| i.to_le_bytes()[..size].to_vec()).collect();
        let mut document = Document::triangle();
        let accessor = document.accessor(&bytes, component, "SCALAR", 6);
        document.root["meshes"][0]["primitives"][0]["indices"] = json!(accessor);
        let (mesh, report) = document.read().unwrap();
        assert_eq!(mesh.triangles, [[2, 0, 1]]);
        assert_eq!(report.degenerate_triangles, 1);
    }
}

#[test]
fn transforms_move_positions_and_turn_normals() {
    let mut document = Document::triangle();
    let normal = Vec3::new(0.0, 1.0, 1.0).normalize();
    let accessor = document.floats(&normal.to_array().repeat(3), 3);
    document.root["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(accessor);
    // The parent mirrors x and stretches z; the child turns 90° about +y and moves.
    document.root["nodes"] = json!([
        {"children": [1], "scale": [-1.0, 1.0, 2.0]},
        {"mesh": 0, "translation": [1.0, 2.0, 3.0], "rotation": [0.0, 0.5f64.sqrt(), 0.0, 0.5f64.sqrt()]},
    ]);
    let mesh = document.mesh();
    // Child: (x, y, z) → (z, y, −x) + (1, 2, 3).
    let expected = [Vec3::new(-1.0, 2.0, 6.0), Vec3::new(-1.0, 2.0, 4.0), Vec3::new(-1.0, 3.0, 6.0)];
    for (found, wanted) in mesh.positions.iter().zip(expected) {
        assert!((*found - wanted).length() < 1e-5, "{found} {wanted}");
    }
    assert_eq!(mesh.triangles, [[0, 2, 1]], "mirroring must turn the winding");
    let [a, b, c] = mesh.corners(0);
    let face = (b - a).cross(c - a).normalize();
    assert!((face - Vec3::NEG_X).length() < 1e-5, "{face}");
    // (0, 1, 1) → turned (1, 1, 0) → divided by the scales (−1, 1, 0).
    let wanted = Vec3::new(-1.0, 1.0, 0.0).normalize();
    assert!((mesh.normals[0] - wanted).length() < 1e-5, "{}", mesh.normals[0]);
}

#[test]
fn all_scenes_are_read_and_shared_nodes_once() {
    let mut document = Document::triangle();
    document.root["nodes"] = json!([{"mesh": 0}, {"mesh": 0, "translation": [0, 0, 5]}, {"mesh": 0}]);
    document.root["scenes"] = json!([{"nodes": [0]}, {"nodes": [0, 1]}]);
    assert_eq!(document.mesh().triangles, [[0, 1, 2], [3, 4, 5]]);
    // Without scenes, every node counts.
    document.root["scenes"] = json!([]);
    assert_eq!(document.mesh().triangles.len(), 3);
}

#[test]
fn uvs_are_kept_only_if_complete() {
    let mut document = Document::triangle();
    let uvs = document.accessor(&[0, 0, 255, 0, 0, 255], 5121, "VEC2", 3);
    document.root["accessors"][uvs]["normalized"] = json!(true);
    document.root["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(uvs);
    let (mesh, report) = document.read().unwrap();
    assert_eq!(mesh.uvs, Some(vec![Vec2::ZERO, Vec2::X, Vec2::Y]));
    assert!(!report.dropped_uvs);
    document.primitive(json!({"attributes": {"POSITION": 0}}));
    let (mesh, report) = document.read().unwrap();
    assert_eq!((mesh.uvs, mesh.triangles.len()), (None, 2));
    assert!(report.dropped_uvs);
}

#[test]
fn sparse_and_interleaved_accessors() {
    // Positions all zero but for two, given sparsely.
    let mut document = Document::new();
    let indices = document.accessor(&[1, 2], 5121, "SCALAR", 2);
    let values = document.floats(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0], 3);
    let sparse = json!({
        "count": 2,
        "indices": {"bufferView": indices, "componentType": 5121},
        "values": {"bufferView": values},
    });
    let accessor = document
        .push("accessors", json!({"componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse}));
    document.primitive(json!({"attributes": {"POSITION": accessor}}));
    assert_eq!(document.mesh().positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
    // Position and normal in one view, 24 bytes apart.
    let mut document = Document::new();
    let both: Vec<f32> = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        .iter()
        .flat_map(|p| [p[0], p[1], p[2], 0.0, 0.0, -1.0])
        .collect();
    let positions = document.floats(&both, 3);
    document.root["bufferViews"][0]["byteStride"] = json!(24);
    document.root["accessors"][positions]["count"] = json!(3);
    let mut normals = document.root["accessors"][positions].clone();
    normals["byteOffset"] = json!(12);
    let normals = document.push("accessors", normals);
    document.primitive(json!({"attributes": {"POSITION": positions, "NORMAL": normals}}));
    let mesh = document.mesh();
    assert_eq!((mesh.positions[2], mesh.normals[2]), (Vec3::Y, Vec3::NEG_Z));
}

#[test]
fn external_buffers_are_found_beside_the_file_or_missed_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.gltf");
    let mut document = Document::triangle();
    document.root["buffers"] = json!([{"byteLength": document.bytes.len(), "uri": "the%20data.bin"}]);
    std::fs::write(&path, document.text()).unwrap();
    assert_refused(read_mesh_with_report(&path), "the data.bin: there is no such file");
    std::fs::write(folder.path().join("the data.bin"), &document.bytes).unwrap();
    assert_eq!(read_mesh(&path).unwrap().triangles.len(), 1);
    std::fs::write(folder.path().join("the data.bin"), &document.bytes[1..]).unwrap();
    assert_refused(read_mesh_with_report(&path), "buffer 0: is truncated: 35 bytes of 36");
    for (uri, words) in [
        ("http://example.org/x.bin", "outside the file system"),
        ("%ff.bin", "not valid UTF-8"),
        ("data:;base64,!!!", "cannot be decoded"),
        (".", "cannot be read"),
    ] {
        document.root["buffers"] = json!([{"byteLength": 36, "uri": uri}]);
        assert_refused(document.read(), words);
    }
    document.root["buffers"] = json!([{"byteLength": 36}]);
    assert_refused(document.read(), "has no data");
}

#[test]
fn what_is_no_gltf_is_refused() {
    assert_refused(read_bytes(b""), "the file is empty");
    assert_refused(read_bytes(b"ply\nformat ascii 1.0"), "not a readable glTF");
    assert_refused(read_bytes(&[0xff; 64]), "not a readable glTF");
    assert_refused(read_bytes(b"glTF\x01\0\0\0\x14\0\0\0"), "version 1");
    // Nesting that would overflow a naive parser's stack.
    assert_refused(read_bytes("[".repeat(1_000_000).as_bytes()), "not a readable glTF");
    let nowhere = PathBuf::from("/nonexistent/mesh.glb");
    assert!(matches!(read_mesh(&nowhere), Err(Error::Input { .. })));
    let folder = tempfile::tempdir().unwrap();
    assert_refused(read_mesh_with_report(folder.path()), "this is a folder, not a file");
}

#[test]
fn every_truncation_of_a_glb_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.glb");
    let mesh = crate::mesh::primitive::box_mesh(Vec3::ZERO, Vec3::ONE).unwrap();
    crate::codec::gltf::export::write_glb(&path, &mesh, None).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    for length in (0..bytes.len()).step_by(7).chain(bytes.len() - 3..bytes.len()) {
        std::fs::write(&path, &bytes[..length]).unwrap();
        assert!(matches!(read_mesh(&path), Err(Error::Input { .. })), "{length} of {}", bytes.len());
        // The same with a header that admits the length: still no panic, and never a mesh other than the whole one.
        if length >= 12 {
            let mut honest = bytes[..length].to_vec();
            honest[8..12].copy_from_slice(&(length as u32).to_le_bytes());
            std::fs::write(&path, &honest).unwrap();
            assert!(read_mesh(&path).is_err());
        }
    }
}

#[test]
fn ranges_are_checked() {
    let mut document = Document::triangle();
    document.root["accessors"][0]["count"] = json!(4);
    assert_refused(document.read(), "accessor 0: is out of range: needs 48 bytes");
    document.root["accessors"][0]["count"] = json!(u64::MAX);
    assert_refused(document.read(), "all instances counted");
    let mut document = Document::triangle();
    document.root["accessors"][0]["byteOffset"] = json!(u64::MAX - 3);
    assert_refused(document.read(), "out of range");
    let mut document = Document::triangle();
    document.root["bufferViews"][0]["byteLength"] = json!(40);
    assert_refused(document.read(), "beyond its buffer");
    for (pointer, words) in [
        ("/bufferViews/0/buffer", "refers to buffer 9"),
        ("/accessors/0/bufferView", "refers to buffer view 9"),
        ("/meshes/0/primitives/0/attributes/POSITION", "refers to accessor 9"),
        ("/nodes/0/mesh", "refers to mesh 9"),
        ("/scenes/0/nodes/0", "refers to node 9"),
    ] {
        let mut document = Document::triangle();
        *document.root.pointer_mut(pointer).unwrap() = json!(9);
        assert_refused(document.read(), words);
    }
    let mut document = Document::triangle();
    let accessor = document.accessor(&[0, 1, 3], 5121, "SCALAR", 3);
    document.root["meshes"][0]["primitives"][0]["indices"] = json!(accessor);
    assert_refused(document.read(), "vertex index 3 is out of range: there are 3 vertices");
}

#[test]
fn wrong_types_are_refused() {
    for (pointer, value, words) in [
        ("/accessors/0/type", json!("VEC2"), "2 components"),
        ("/accessors/0/type", json!("MAT4"), "type"),
        ("/accessors/0/componentType", json!(5130), "component type"),
        ("/meshes/0/primitives/0/mode", json!(17), "primitive mode"),
        ("/meshes/0/primitives/0/attributes", json!({"NORMAL": 0}), "no vertex positions"),
        ("/meshes/0/primitives/0/indices", json!(0), "unsigned"),
        ("/nodes/0/rotation", json!([0, 0, 0, 0]), "quaternion"),
    ] {
        let mut document = Document::triangle();
        document.root["meshes"][0]["primitives"][0]["mode"] = json!(4);
        document.root["meshes"][0]["primitives"][0]["indices"] = Value::Null;
        document.root["nodes"][0]["rotation"] = Value::Null;
        *document.root.pointer_mut(pointer).unwrap() = value;
        assert_refused(document.read(), words);
    }
    let mut document = Document::triangle();
    let normals = document.floats(&[0.0, 0.0, 1.0], 3);
    document.root["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(normals);
    assert_refused(document.read(), "3 positions but 1");
}

#[test]
fn cyclic_and_tangled_node_graphs_are_refused() {
    for nodes in [
        json!([{"mesh": 0, "children": [0]}]),
        json!([{"mesh": 0, "children": [1]}, {"children": [2]}, {"children": [0]}]),
        // A cycle that no scene reaches.
        json!([{"mesh": 0}, {"children": [2]}, {"children": [1]}]),
    ] {
        let mut document = Document::triangle();
        document.root["nodes"] = nodes;
        assert_refused(document.read(), "cyclic");
    }
    // Thirty levels of doubled children would be a thousand million triangles.
    let mut document = Document::triangle();
    let nodes: Vec<Value> =
        (0..30).map(|n| json!({"children": [n + 1, n + 1]})).chain([json!({"mesh": 0})]).collect();
    document.root["nodes"] = json!(nodes);
    assert_refused(document.read(), "not a tree");
    // A long chain is a legal tree.
    let nodes: Vec<Value> =
        (0..100_000).map(|n| json!({"children": [n + 1]})).chain([json!({"mesh": 0})]).collect();
    document.root["nodes"] = json!(nodes);
    assert_eq!(document.mesh().triangles.len(), 1);
}

#[test]
fn a_file_without_triangles_is_refused() {
    assert_refused(Document::new().read(), "has no triangles");
    assert_refused(read_bytes(br#"{"asset": {"version": "2.0"}}"#), "has no triangles");
    let mut document = Document::triangle();
    document.root["meshes"][0]["primitives"][0]["mode"] = json!(1);
    assert_refused(document.read(), "has no triangles");
    let flat = Document::with_triangle([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    assert_refused(flat.read(), "only 1 degenerate");
    // A transform that flattens everything leaves nothing either.
    let mut document = Document::triangle();
    document.root["nodes"][0]["scale"] = json!([1.0, 0.0, 1.0]);
    assert_refused(document.read(), "only 1 degenerate");
}

#[test]
fn positions_that_are_not_finite_are_named() {
    for bad in [f32::NAN, f32::INFINITY] {
        let document = Document::with_triangle([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, bad, 0.0]);
        assert_refused(document.read(), "primitive 0, vertex 2: its position is not finite");
    }
    // Finite in the file, overflowing in the world.
    let mut document = Document::with_triangle([0.0, 0.0, 0.0, 1e30, 0.0, 0.0, 0.0, 1.0, 0.0]);
    document.root["nodes"][0]["scale"] = json!([1e20, 1.0, 1.0]);
    assert_refused(document.read(), "vertex 1");
    // Finite, and beyond what anything is placed at.
    let mut document = Document::triangle();
    document.root["nodes"][0]["scale"] = json!([1e25, 1e25, 1e25]);
    assert_refused(document.read(), "no coordinate may be beyond 1e9");
}

#[test]
fn required_extensions_that_matter_are_refused() {
    let mut document = Document::triangle();
    document.root["extensionsRequired"] = json!(["KHR_materials_ior", "KHR_draco_mesh_compression"]);
    assert_refused(document.read(), "KHR_draco_mesh_compression");
    document.root["extensionsRequired"] = json!(["KHR_materials_ior", "KHR_texture_transform"]);
    assert_eq!(document.mesh().triangles.len(), 1);
}

/// A mesh of `count` positions that need no bytes: one sparse element over zeros.
fn sparse(count: u64) -> Document {
    let mut document = Document::new();
    let at = document.accessor(&0_u32.to_le_bytes(), 5125, "SCALAR", 1);
    let what = document.floats(&[1.0, 2.0, 3.0], 3);
    let views = [at, what].map(|accessor| document.root["accessors"][accessor]["bufferView"].clone());
    let accessor = document.push(
        "accessors",
        json!({"componentType": 5126, "count": count, "type": "VEC3", "sparse": {
            "count": 1,
            "indices": {"bufferView": views[0], "componentType": 5125},
            "values": {"bufferView": views[1]},
        }}),
    );
    document.primitive(json!({"attributes": {"POSITION": accessor}}));
    document
}

#[test]
fn sizes_that_no_byte_of_the_file_bears_out_are_refused_at_once() {
    let started = std::time::Instant::now();
    for count in [100_000_000, u64::from(u32::MAX), u64::MAX / 2] {
        assert_refused(sparse(count).read(), "all instances counted; the limits are 10000000 and 30000000");
    }
    assert!(sparse(3).read().is_err_and(|error| error.to_string().contains("1 degenerate")));
    // Attributes beside positions are compared before they are read.
    let mut document = Document::triangle();
    let huge = sparse(90_000_000).root["accessors"][2].clone();
    let accessor = document.push("accessors", huge);
    document.root["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(accessor);
    assert_refused(document.read(), "has 3 positions but 90000000 normals");
    assert!(started.elapsed().as_secs() < 2);
}

#[test]
fn instances_are_counted_before_their_triangles_are_made() {
    let mut document = Document::new();
    let positions: Vec<f32> = (0..90_000_u64).map(|k| (k * k % 977) as f32).collect();
    let accessor = document.floats(&positions, 3);
    document.primitive(json!({"attributes": {"POSITION": accessor}}));
    let instances = |count: usize| {
        json!((0..count).map(|k| json!({"mesh": 0, "translation": [k, 0, 0]})).collect::<Vec<_>>())
    };
    document.root["nodes"] = instances(1001);
    document.root["scenes"] = json!([{"nodes": (0..1001).collect::<Vec<_>>()}]);
    assert_refused(document.read(), "has 10010000 triangles and 30030000 vertices");
    document.root["nodes"] = instances(2);
    document.root["scenes"] = json!([{"nodes": [0, 1]}]);
    let report = document.read().unwrap().1;
    assert_eq!(report.primitives, 2);
    document.root["nodes"][1]["mesh"] = json!(7);
    assert_refused(document.read(), "refers to mesh 7, but the file has 1");
}

#[test]
fn buffers_are_bounded_together() {
    let mut document = Document::triangle();
    let uri = "data:application/octet-stream;base64,AAAA";
    let buffer = json!({"byteLength": 3_000_000_000_u64, "uri": uri});
    document.root["buffers"] = json!([buffer, buffer]);
    assert_refused(document.read(), "claim 6000000000 bytes, more than 4294967296");
}
