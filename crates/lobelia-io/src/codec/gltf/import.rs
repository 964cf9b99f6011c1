//! Reading a mesh from a `.glb` or `.gltf` file. All triangles of the file become one mesh in world
//! space.
//!
//! ```
//! use glam::Vec3;
//! use lobelia_geometry::mesh::primitive::box_mesh;
//! use lobelia_io::codec::gltf::{export::write_glb, import::read_mesh};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("box.glb");
//! let mesh = box_mesh(Vec3::X, Vec3::new(1.0, 2.0, 3.0))?;
//! write_glb(&path, &mesh, None)?;
//! assert_eq!(read_mesh(&path)?, mesh);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::codec::gltf::GltfFile;
use glam::{DMat3, Mat3, Mat4, Quat, Vec2, Vec3};
use gltf_json::mesh::{Mode, Primitive, Semantic};
use gltf_json::{Index, scene::Node, validation::Checked};
use lobelia_geometry::{Error, Result, mesh::MAX_COORDINATE, mesh::triangles::Mesh};
use std::{collections::HashSet, path::Path};

/// Most triangles of all instances together. An atlas has at most 4096² texels: more triangles
/// would show nothing.
const MAX_TRIANGLES: u64 = 10_000_000;

/// Omissions and repairs of [`read_mesh_with_report`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MeshReport {
    /// Primitives read (a mesh of several nodes counts once per node).
    pub primitives: usize,
    /// Primitives of points or lines, skipped.
    pub skipped_primitives: usize,
    /// Triangles without area, dropped.
    pub degenerate_triangles: usize,
    /// Vertices whose normal was missing, zero or not finite and was computed from the faces.
    pub computed_normals: usize,
    /// True if texture coordinates were dropped, because some primitives have none or some are not
    /// finite.
    pub dropped_uvs: bool,
}

impl MeshReport {
    /// Descriptions of the repairs, one sentence each; empty if nothing was repaired.
    pub fn notes(&self) -> Vec<String> {
        let Self { skipped_primitives, degenerate_triangles, computed_normals, dropped_uvs, .. } = *self;
        let notes = [
            (skipped_primitives, format!("skipped {skipped_primitives} primitives of points or lines")),
            (degenerate_triangles, format!("dropped {degenerate_triangles} triangles without area")),
            (computed_normals, format!("computed {computed_normals} missing vertex normals from the faces")),
            (
                usize::from(dropped_uvs),
                "ignored the texture coordinates: not every vertex has finite ones".to_owned(),
            ),
        ];
        notes.into_iter().filter(|(count, _)| *count > 0).map(|(_, note)| note).collect()
    }
}

/// Reads all triangles of all scenes of a `.glb` or `.gltf` file, in world space.
///
/// Triangles, strips and fans of every node of every scene (of every node, if the file has no
/// scene) are taken, with the nodes' transforms; skins and morph targets stay in their rest pose.
/// Missing normals are computed as smooth normals. If only some primitives have texture
/// coordinates, they are dropped for all.
///
/// # Errors
/// [`Error::Input`] or [`Error::Io`] for anything that is not a readable glTF 2.0 file with at
/// least one triangle.
pub fn read_mesh(path: &Path) -> Result<Mesh> {
    read_mesh_with_report(path).map(|(mesh, _)| mesh)
}

/// [`read_mesh`], and a report of repairs.
///
/// # Errors
/// As for [`read_mesh`].
pub fn read_mesh_with_report(path: &Path) -> Result<(Mesh, MeshReport)> {
    let file = GltfFile::open(path)?;
    let mut gathered = Gathered::default();
    for (node, world_from_node) in placed_nodes(&file)? {
        let place = format!("node {node}");
        let Some(mesh) = file.root.nodes[node].mesh else { continue };
        for (k, primitive) in
            file.item(&file.root.meshes, mesh, "mesh", &place)?.primitives.iter().enumerate()
        {
            gathered.add(&file, primitive, world_from_node, &format!("{place}, primitive {k}"))?;
        }
    }
    gathered.finish(&file)
}

/// Every node to draw with its world transform, each once, parents first.
fn placed_nodes(file: &GltfFile) -> Result<Vec<(usize, Mat4)>> {
    let nodes = &file.root.nodes;
    let mut roots: Vec<Index<Node>> =
        file.root.scenes.iter().flat_map(|scene| scene.nodes.iter().copied()).collect();
    if file.root.scenes.is_empty() {
        let children: HashSet<usize> =
            nodes.iter().flat_map(|node| node.children.iter().flatten()).map(Index::value).collect();
        roots.extend((0..nodes.len()).filter(|node| !children.contains(node)).map(|i| Index::new(i as u32)));
    }
    let mut stack: Vec<_> = roots.into_iter().rev().map(|root| (root, Mat4::IDENTITY)).collect();
    // A node that several scenes list is one object, not several.
    let (mut seen, mut placed) = (vec![false; nodes.len()], Vec::new());
    while let Some((index, world_from_parent)) = stack.pop() {
        let node = file.item(nodes, index, "node", "a scene or a node above it")?;
        if std::mem::replace(&mut seen[index.value()], true) {
            continue;
        }
        let world_from_node = world_from_parent * parent_from_node(file, index.value(), node)?;
        placed.push((index.value(), world_from_node));
        stack.extend(node.children.iter().flatten().rev().map(|child| (*child, world_from_node)));
    }
    Ok(placed)
}

fn parent_from_node(file: &GltfFile, index: usize, node: &Node) -> Result<Mat4> {
    if let Some(matrix) = &node.matrix {
        return Ok(Mat4::from_cols_array(matrix));
    }
    let rotation = node.rotation.map_or(Quat::IDENTITY, |q| Quat::from_array(q.0));
    let squared = rotation.length_squared();
    if !(squared.is_finite() && squared > 1e-12) {
        return Err(file.error(format!("node {index}"), "its rotation is not a quaternion of unit length"));
    }
    let rotation = if rotation == Quat::IDENTITY { rotation } else { rotation * squared.sqrt().recip() };
    let scale = node.scale.map_or(Vec3::ONE, Vec3::from);
    let translation = node.translation.map_or(Vec3::ZERO, Vec3::from);
    Ok(Mat4::from_scale_rotation_translation(scale, rotation, translation))
}

/// The mesh under construction.
#[derive(Default)]
struct Gathered {
    mesh: Mesh,
    uvs: Vec<Vec2>,
    /// Primitives that have texture coordinates.
    with_uvs: usize,
    report: MeshReport,
}

impl Gathered {
    /// Adds a primitive; each vertex has all its attributes, and each index is that of a vertex.
    fn add(&mut self, file: &GltfFile, primitive: &Primitive, world: Mat4, place: &str) -> Result<()> {
        let Checked::Valid(mode) = primitive.mode else {
            return Err(file.error(place, "has an unknown primitive mode"));
        };
        if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
            self.report.skipped_primitives += 1;
            return Ok(());
        }
        let attribute = |semantic| primitive.attributes.get(&Checked::Valid(semantic)).copied();
        let (normals, uvs) = (attribute(Semantic::Normals), attribute(Semantic::TexCoords(0)));
        let accessor =
            attribute(Semantic::Positions).ok_or_else(|| file.error(place, "has no vertex positions"))?;
        let count = file.count(accessor, place)?;
        let corners = primitive.indices.map_or(Ok(count), |accessor| file.count(accessor, place))?;
        self.check_size(file, if mode == Mode::Triangles { corners / 3 } else { corners }, count)?;
        for other in [normals, uvs].into_iter().flatten() {
            let other = file.count(other, place)?;
            if other != count {
                let problem = format!("has {count} positions but {other} normals or texture coordinates");
                return Err(file.error(place, problem));
            }
        }
        let positions = file.floats::<3>(accessor, place)?;
        let count = positions.len();
        let indices = match primitive.indices {
            Some(accessor) => file.indices(accessor, place)?,
            None => (0..count as u32).collect(),
        };
        if let Some(bad) = indices.iter().find(|&&i| i as usize >= count) {
            let problem = format!("vertex index {bad} is out of range: there are {count} vertices");
            return Err(file.error(place, problem));
        }
        self.add_triangles(&indices, mode, world);
        self.add_positions(file, &positions, world, place)?;
        // Missing normals stay zero until [`Gathered::finish`].
        let normals = normals.map_or(Ok(vec![[0.0; 3]; count]), |index| file.floats::<3>(index, place))?;
        let cofactors = inverse_transpose_direction(Mat3::from_mat4(world));
        self.mesh.normals.extend(normals.into_iter().map(Vec3::from).map(|normal| {
            if world == Mat4::IDENTITY || !normal.is_finite() {
                return normal;
            }
            (cofactors * normal.as_dvec3()).normalize_or_zero().as_vec3()
        }));
        self.with_uvs += usize::from(uvs.is_some());
        let uvs = uvs.map_or(Ok(vec![[0.0; 2]; count]), |index| file.floats::<2>(index, place))?;
        self.uvs.extend(uvs.into_iter().map(Vec2::from));
        self.report.primitives += 1;
        Ok(())
    }

    /// Refuses more triangles or vertices than can be used, before they are read: a mesh counts
    /// once for each node that shows it.
    fn check_size(&self, file: &GltfFile, triangles: u64, vertices: u64) -> Result<()> {
        let triangles = triangles.saturating_add(self.mesh.triangles.len() as u64);
        let vertices = vertices.saturating_add(self.mesh.positions.len() as u64);
        if triangles <= MAX_TRIANGLES && vertices <= 3 * MAX_TRIANGLES {
            return Ok(());
        }
        let problem = format!(
            "has at least {triangles} triangles and {vertices} vertices, all instances counted; the limits are {MAX_TRIANGLES} and {}",
            3 * MAX_TRIANGLES
        );
        let help = "reduce the mesh in another program, or leave out the instances that do not matter";
        Err(Error::input(&file.path, "", problem, help))
    }

    fn add_triangles(&mut self, indices: &[u32], mode: Mode, world: Mat4) {
        let count = if mode == Mode::Triangles { indices.len() / 3 } else { indices.len().saturating_sub(2) };
        let first = self.mesh.positions.len();
        let mirrored = world.determinant() < 0.0;
        self.mesh.triangles.extend((0..count).map(|k| {
            let [a, b, c] = match mode {
                Mode::TriangleStrip => [k, k + 1 + k % 2, k + 2 - k % 2],
                Mode::TriangleFan => [k + 1, k + 2, 0],
                _ => [3 * k, 3 * k + 1, 3 * k + 2],
            }
            .map(|corner| indices[corner] + first as u32);
            if mirrored { [a, c, b] } else { [a, b, c] }
        }));
    }

    fn add_positions(
        &mut self,
        file: &GltfFile,
        positions: &[[f32; 3]],
        world: Mat4,
        place: &str,
    ) -> Result<()> {
        for (vertex, &position) in positions.iter().enumerate() {
            let position = Vec3::from(position);
            // The identity keeps every bit, so that a mesh that was written is read back unchanged.
            let placed = if world == Mat4::IDENTITY { position } else { world.transform_point3(position) };
            let place = || format!("{place}, vertex {vertex}");
            if !placed.is_finite() {
                return Err(file.error(place(), format!("its position is not finite: {placed}")));
            }
            if placed.abs().max_element() > MAX_COORDINATE {
                let problem =
                    format!("its place is {placed}: no coordinate may be beyond {MAX_COORDINATE:e}");
                let help = "Scale the mesh, or the nodes above it, to the unit of the cameras.";
                return Err(Error::input(&file.path, place(), problem, help));
            }
            self.mesh.positions.push(placed);
        }
        Ok(())
    }

    fn finish(mut self, file: &GltfFile) -> Result<(Mesh, MeshReport)> {
        self.report.degenerate_triangles = self.mesh.drop_degenerate_triangles();
        if self.mesh.triangles.is_empty() {
            let problem = match self.report.degenerate_triangles {
                0 => "has no triangles".to_owned(),
                n => format!("has no triangles with an area (only {n} degenerate ones)"),
            };
            return Err(Error::input(&file.path, "", problem, "the surface must be a triangle mesh"));
        }
        let complete = self.with_uvs == self.report.primitives && self.uvs.iter().all(|uv| uv.is_finite());
        self.report.dropped_uvs = self.with_uvs > 0 && !complete;
        self.mesh.uvs = complete.then_some(self.uvs);
        self.report.computed_normals = self.mesh.repair_normals();
        Ok((self.mesh, self.report))
    }
}

/// A positive multiple of the inverse transpose: the cofactor matrix with the determinant's sign,
/// which also exists for singular transforms.
fn inverse_transpose_direction(matrix: Mat3) -> DMat3 {
    let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|axis| axis.as_dvec3());
    let sign = if x.dot(y.cross(z)) < 0.0 { -1.0 } else { 1.0 };
    DMat3::from_cols(y.cross(z) * sign, z.cross(x) * sign, x.cross(y) * sign)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::test_data::temporary;
    use serde_json::{Value, json};

    /// A `.gltf` document under construction; its one buffer becomes a data URI unless told
    /// otherwise.
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
            let view = json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len()});
            let view = self.push("bufferViews", view);
            self.bytes.extend(bytes);
            let of = json!({"bufferView": view, "componentType": component, "count": count, "type": kind});
            self.push("accessors", of)
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

        /// The triangle with another value at a place.
        fn changed(pointer: &str, value: Value) -> Self {
            let mut document = Self::triangle();
            let (parent, key) = pointer.rsplit_once('/').unwrap();
            document.root.pointer_mut(parent).unwrap()[key] = value;
            document
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
        use base64::Engine as _;
        base64::engine::general_purpose::STANDARD.encode(bytes)
    }

    fn read_bytes(bytes: &[u8]) -> Result<(Mesh, MeshReport)> {
        let (_folder, path) = temporary("mesh.gltf");
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
    fn interleaved_accessors_are_read() {
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
        let (folder, path) = temporary("mesh.gltf");
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
    fn other_files_are_refused() {
        assert_refused(read_bytes(b""), "the file is empty");
        assert_refused(read_bytes(b"ply\nformat ascii 1.0"), "not a readable glTF");
        assert_refused(read_bytes(b"glTF\x01\0\0\0\x14\0\0\0"), "version 1");
        // Nesting that would overflow a naive parser's stack.
        assert_refused(read_bytes("[".repeat(1_000_000).as_bytes()), "not a readable glTF");
    }

    #[test]
    fn bad_documents_are_refused() {
        let part = json!({"bufferView": 0, "componentType": 5125});
        let first = "/meshes/0/primitives/0";
        for (pointer, value, words) in [
            ("/accessors/0/count", json!(4), "accessor 0: is out of range: needs 48 bytes"),
            (
                "/accessors/0/count",
                json!(u64::MAX),
                "all instances counted; the limits are 10000000 and 30000000",
            ),
            ("/accessors/0/byteOffset", json!(u64::MAX - 3), "out of range"),
            ("/accessors/0/type", json!("VEC2"), "2 components"),
            ("/accessors/0/type", json!("MAT4"), "type"),
            ("/accessors/0/componentType", json!(5130), "component type"),
            ("/accessors/0/sparse", json!({"count": 1, "indices": part, "values": part}), "0: is sparse"),
            ("/accessors/0/bufferView", json!(9), "refers to buffer view 9"),
            ("/bufferViews/0/byteLength", json!(40), "beyond its buffer"),
            ("/bufferViews/0/buffer", json!(9), "refers to buffer 9"),
            (&format!("{first}/attributes/POSITION"), json!(9), "refers to accessor 9"),
            (&format!("{first}/attributes"), json!({"NORMAL": 0}), "no vertex positions"),
            (&format!("{first}/indices"), json!(0), "3 components per element where 1 are needed"),
            (&format!("{first}/mode"), json!(17), "primitive mode"),
            (&format!("{first}/mode"), json!(1), "has no triangles"),
            ("/meshes/0/primitives", json!([]), "has no triangles"),
            ("/nodes/0/mesh", json!(9), "refers to mesh 9"),
            ("/nodes/0/rotation", json!([0, 0, 0, 0]), "quaternion"),
            // A transform that flattens everything, and one that leads beyond what anything is
            // placed at.
            ("/nodes/0/scale", json!([1.0, 0.0, 1.0]), "only 1 degenerate"),
            ("/nodes/0/scale", json!([1e25, 1e25, 1e25]), "no coordinate may be beyond 1e9"),
            ("/scenes/0/nodes", json!([9]), "refers to node 9"),
            ("/extensionsRequired", json!(["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
        ] {
            assert_refused(Document::changed(pointer, value).read(), words);
        }
        let mut document = Document::triangle();
        let accessor = document.accessor(&[0, 1, 3], 5121, "SCALAR", 3);
        document.root["meshes"][0]["primitives"][0]["indices"] = json!(accessor);
        assert_refused(document.read(), "vertex index 3 is out of range: there are 3 vertices");
        document.root["accessors"][accessor]["componentType"] = json!(5120);
        assert_refused(document.read(), "vertex indices must be unsigned");
        let mut document = Document::triangle();
        let normals = document.floats(&[0.0, 0.0, 1.0], 3);
        document.root["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(normals);
        assert_refused(document.read(), "3 positions but 1");
        for (at, bad, words) in [
            (7, f32::NAN, "primitive 0, vertex 2: its position is not finite"),
            (7, f32::INFINITY, "primitive 0, vertex 2: its position is not finite"),
            (7, 0.0, "only 1 degenerate"),
        ] {
            let mut positions = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
            positions[at] = bad;
            assert_refused(Document::with_triangle(positions).read(), words);
        }
        // Finite in the file, overflowing in the world.
        let mut document = Document::with_triangle([0.0, 0.0, 0.0, 1e30, 0.0, 0.0, 0.0, 1.0, 0.0]);
        document.root["nodes"][0]["scale"] = json!([1e20, 1.0, 1.0]);
        assert_refused(document.read(), "vertex 1");
    }

    #[test]
    fn long_chains_cycles_and_harmless_extensions_are_read() {
        let nodes = (0..100_000).map(|n| json!({"children": [n + 1]})).chain([json!({"mesh": 0})]);
        let cycle = json!([{"children": [1, 1]}, {"mesh": 0, "children": [0, 2]}, {"children": [1]}]);
        let extensions = json!(["KHR_materials_ior", "KHR_texture_transform"]);
        for (pointer, value) in
            [("/nodes", nodes.collect()), ("/nodes", cycle), ("/extensionsRequired", extensions)]
        {
            assert_eq!(Document::changed(pointer, value).mesh().triangles.len(), 1);
        }
    }
}
