//! Reading a mesh from a `.glb` or `.gltf` file.

use crate::codec::gltf::file::GltfFile;
use crate::mesh::MAX_COORDINATE;
use crate::mesh::triangles::Mesh;
use crate::{Error, Result};
use glam::{DMat3, Mat3, Mat4, Quat, Vec2, Vec3};
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::scene::Node;
use gltf::json::validation::Checked;
use std::path::Path;

/// Most triangles of all instances together. An atlas has at most 4096² texels: more triangles would show nothing.
const MAX_TRIANGLES: u64 = 10_000_000;

/// What [`read_mesh_with_report`] left out or repaired.
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
    /// Whether texture coordinates were dropped, because some primitives have none or some are not finite.
    pub dropped_uvs: bool,
}

impl MeshReport {
    /// Descriptions of the repairs, one sentence each; empty if nothing was repaired.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.skipped_primitives > 0 {
            notes.push(format!("skipped {} primitives of points or lines", self.skipped_primitives));
        }
        if self.degenerate_triangles > 0 {
            notes.push(format!("dropped {} triangles without area", self.degenerate_triangles));
        }
        if self.computed_normals > 0 {
            notes.push(format!("computed {} missing vertex normals from the faces", self.computed_normals));
        }
        if self.dropped_uvs {
            notes.push("ignored the texture coordinates: not every vertex has finite ones".to_owned());
        }
        notes
    }
}

/// Reads all triangles of all scenes of a `.glb` or `.gltf` file, in world space.
///
/// Triangles, strips and fans of every node of every scene (of every node, if the file has no scene) are taken, with the nodes'
/// transforms; skins and morph targets stay in their rest pose. Missing normals are computed as smooth normals. If only some primitives have
/// texture coordinates, they are dropped for all.
///
/// # Errors
/// [`Error::Input`] or [`Error::Io`] for anything that is not a readable glTF 2.0 file with at least one triangle.
pub fn read_mesh(path: &Path) -> Result<Mesh> {
    read_mesh_with_report(path).map(|(mesh, _)| mesh)
}

/// [`read_mesh`], and a report of repairs.
///
/// # Errors
/// Those of [`read_mesh`].
pub fn read_mesh_with_report(path: &Path) -> Result<(Mesh, MeshReport)> {
    let file = GltfFile::open(path)?;
    let placed = placed_nodes(&file)?;
    check_size(&file, &placed)?;
    let mut gathered =
        Gathered { mesh: Mesh::default(), uvs: Vec::new(), with_uvs: 0, report: MeshReport::default() };
    for (node, world_from_node) in placed {
        if let Some(mesh) = file.root.nodes[node].mesh {
            let place = format!("node {node}");
            for (k, primitive) in
                file.item(&file.root.meshes, mesh, "mesh", &place)?.primitives.iter().enumerate()
            {
                let place = format!("node {node}, mesh {}, primitive {k}", mesh.value());
                gathered.add_primitive(&file, primitive, world_from_node, &place)?;
            }
        }
    }
    gathered.finish(&file)
}

/// Refuses more triangles or vertices than can be used, before any is read: a mesh counts once for each node that shows it.
fn check_size(file: &GltfFile, placed: &[(usize, Mat4)]) -> Result<()> {
    let mut shown = vec![0_u64; file.root.meshes.len()];
    for (node, _) in placed {
        if let Some(mesh) = file.root.nodes[*node].mesh {
            file.item(&file.root.meshes, mesh, "mesh", &format!("node {node}"))?;
            shown[mesh.value()] += 1;
        }
    }
    let (mut triangles, mut vertices) = (0_u64, 0_u64);
    for (index, times) in shown.into_iter().enumerate().filter(|(_, times)| *times > 0) {
        for (k, primitive) in file.root.meshes[index].primitives.iter().enumerate() {
            let place = format!("mesh {index}, primitive {k}");
            let [t, v] = size(file, primitive, &place)?;
            triangles = triangles.saturating_add(t.saturating_mul(times));
            vertices = vertices.saturating_add(v.saturating_mul(times));
        }
    }
    if triangles <= MAX_TRIANGLES && vertices <= 3 * MAX_TRIANGLES {
        return Ok(());
    }
    let problem = format!(
        "has {triangles} triangles and {vertices} vertices, all instances counted; the limits are {MAX_TRIANGLES} and {}",
        3 * MAX_TRIANGLES
    );
    let help = "reduce the mesh in another program, or leave out the instances that do not matter";
    Err(Error::input(&file.path, "", problem, help))
}

/// Triangles and vertices that a primitive claims to have; none for points and lines.
fn size(file: &GltfFile, primitive: &Primitive, place: &str) -> Result<[u64; 2]> {
    let positions = primitive.attributes.get(&Checked::Valid(Semantic::Positions));
    let vertices = positions.map_or(Ok(0), |accessor| file.count(*accessor, place))?;
    let corners = primitive.indices.map_or(Ok(vertices), |accessor| file.count(accessor, place))?;
    Ok(match primitive.mode {
        Checked::Valid(Mode::Triangles) => [corners / 3, vertices],
        Checked::Valid(Mode::TriangleStrip | Mode::TriangleFan) => [corners.saturating_sub(2), vertices],
        _ => [0, 0],
    })
}

/// Every node to draw with its world transform, each once, parents first.
fn placed_nodes(file: &GltfFile) -> Result<Vec<(usize, Mat4)>> {
    let nodes = &file.root.nodes;
    let parents = parents(file)?;
    check_acyclic(file, &parents)?;
    let mut stack = Vec::new();
    for (index, scene) in file.root.scenes.iter().enumerate() {
        for &root in &scene.nodes {
            file.item(nodes, root, "node", &format!("scene {index}"))?;
            stack.push((root.value(), Mat4::IDENTITY));
        }
    }
    if file.root.scenes.is_empty() {
        stack = (0..nodes.len()).filter(|&n| parents[n].is_none()).map(|n| (n, Mat4::IDENTITY)).collect();
    }
    stack.reverse();
    // A node that several scenes list is one object, not several.
    let mut seen = vec![false; nodes.len()];
    let mut placed = Vec::new();
    while let Some((node, world_from_parent)) = stack.pop() {
        if std::mem::replace(&mut seen[node], true) {
            continue;
        }
        let world_from_node = world_from_parent * parent_from_node(file, node)?;
        placed.push((node, world_from_node));
        let children = nodes[node].children.iter().flatten().rev();
        stack.extend(children.map(|child| (child.value(), world_from_node)));
    }
    Ok(placed)
}

/// The parent of every node; a node with two parents is an error (glTF 2.0, section 3.5.2: strict trees).
fn parents(file: &GltfFile) -> Result<Vec<Option<usize>>> {
    let mut parents = vec![None; file.root.nodes.len()];
    for (index, node) in file.root.nodes.iter().enumerate() {
        for &child in node.children.iter().flatten() {
            let place = format!("node {index}");
            file.item(&file.root.nodes, child, "node", &place)?;
            if let Some(other) = parents[child.value()].replace(index) {
                let problem = format!(
                    "its child {} also belongs to node {other}: the nodes are not a tree",
                    child.value()
                );
                return Err(file.error(place, problem));
            }
        }
    }
    Ok(parents)
}

/// Walks from every node to the root; meeting the same walk again is a cycle.
fn check_acyclic(file: &GltfFile, parents: &[Option<usize>]) -> Result<()> {
    // 0: not seen; n + 1: first seen on the walk that began at n.
    let mut walk = vec![0; parents.len()];
    for start in 0..parents.len() {
        let mut at = Some(start);
        while let Some(node) = at {
            if walk[node] == start + 1 {
                return Err(file.error(
                    format!("node {node}"),
                    "the node graph is cyclic: the node is its own ancestor",
                ));
            }
            if walk[node] != 0 {
                break;
            }
            walk[node] = start + 1;
            at = parents[node];
        }
    }
    Ok(())
}

fn parent_from_node(file: &GltfFile, index: usize) -> Result<Mat4> {
    let node: &Node = &file.root.nodes[index];
    if let Some(matrix) = &node.matrix {
        return Ok(Mat4::from_cols_array(matrix));
    }
    let rotation = match node.rotation {
        None => Quat::IDENTITY,
        Some(q) => {
            let q = Quat::from_array(q.0);
            let squared = q.length_squared();
            if !(squared.is_finite() && squared > 1e-12) {
                return Err(
                    file.error(format!("node {index}"), "its rotation is not a quaternion of unit length")
                );
            }
            if q == Quat::IDENTITY { q } else { q * squared.sqrt().recip() }
        }
    };
    let scale = node.scale.map_or(Vec3::ONE, Vec3::from);
    let translation = node.translation.map_or(Vec3::ZERO, Vec3::from);
    Ok(Mat4::from_scale_rotation_translation(scale, rotation, translation))
}

/// What the file holds of a primitive.
struct PrimitiveArrays {
    positions: Vec<[f32; 3]>,
    normals: Option<Vec<[f32; 3]>>,
    uvs: Option<Vec<[f32; 2]>>,
    /// The vertices of its triangles, strip or fan, one after another.
    indices: Vec<u32>,
}

impl PrimitiveArrays {
    /// Reads all of them; each vertex has all its attributes, and each index is that of a vertex.
    fn read(file: &GltfFile, primitive: &Primitive, place: &str) -> Result<Self> {
        let attribute = |semantic| primitive.attributes.get(&Checked::Valid(semantic)).copied();
        let (normals, uvs) = (attribute(Semantic::Normals), attribute(Semantic::TexCoords(0)));
        let accessor =
            attribute(Semantic::Positions).ok_or_else(|| file.error(place, "has no vertex positions"))?;
        let count = file.count(accessor, place)?;
        for other in [normals, uvs].into_iter().flatten() {
            let other = file.count(other, place)?;
            if other != count {
                let problem = format!("has {count} positions but {other} normals or texture coordinates");
                return Err(file.error(place, problem));
            }
        }
        let positions = file.floats::<3>(accessor, place)?;
        let normals = normals.map(|a| file.floats::<3>(a, place)).transpose()?;
        let uvs = uvs.map(|a| file.floats::<2>(a, place)).transpose()?;
        let indices = match primitive.indices {
            Some(accessor) => file.indices(accessor, place)?,
            None => (0..positions.len() as u32).collect(),
        };
        if let Some(bad) = indices.iter().find(|&&i| i as usize >= positions.len()) {
            let problem =
                format!("vertex index {bad} is out of range: there are {} vertices", positions.len());
            return Err(file.error(place, problem));
        }
        Ok(Self { positions, normals, uvs, indices })
    }
}

/// The mesh under construction.
struct Gathered {
    mesh: Mesh,
    uvs: Vec<Vec2>,
    with_uvs: usize,
    report: MeshReport,
}

impl Gathered {
    fn add_primitive(
        &mut self,
        file: &GltfFile,
        primitive: &Primitive,
        world: Mat4,
        place: &str,
    ) -> Result<()> {
        let mode = match primitive.mode {
            Checked::Valid(mode) => mode,
            Checked::Invalid => return Err(file.error(place, "has an unknown primitive mode")),
        };
        if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
            self.report.skipped_primitives += 1;
            return Ok(());
        }
        let PrimitiveArrays { positions, normals, uvs, indices } =
            PrimitiveArrays::read(file, primitive, place)?;
        self.add_triangles(&indices, mode, world);
        self.add_positions(file, &positions, world, place)?;
        self.add_normals(normals, positions.len(), world);
        self.with_uvs += usize::from(uvs.is_some());
        self.uvs.extend(uvs.unwrap_or_else(|| vec![[0.0; 2]; positions.len()]).into_iter().map(Vec2::from));
        self.report.primitives += 1;
        Ok(())
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
            if !placed.is_finite() {
                return Err(file.error(
                    format!("{place}, vertex {vertex}"),
                    format!("its position is not finite: {placed}"),
                ));
            }
            if placed.abs().max_element() > MAX_COORDINATE {
                let problem =
                    format!("its place is {placed}: no coordinate may be beyond {MAX_COORDINATE:e}");
                let help = "Scale the mesh, or the nodes above it, to the unit of the cameras.";
                return Err(Error::input(&file.path, format!("{place}, vertex {vertex}"), problem, help));
            }
            self.mesh.positions.push(placed);
        }
        Ok(())
    }

    /// Transforms normals by the inverse transpose; missing normals stay zero until [`Gathered::finish`].
    fn add_normals(&mut self, normals: Option<Vec<[f32; 3]>>, count: usize, world: Mat4) {
        let cofactors = inverse_transpose_direction(Mat3::from_mat4(world));
        let place_normal = |normal: [f32; 3]| {
            let normal = Vec3::from(normal);
            if world == Mat4::IDENTITY || !normal.is_finite() {
                return normal;
            }
            (cofactors * normal.as_dvec3()).normalize_or_zero().as_vec3()
        };
        match normals {
            Some(normals) => self.mesh.normals.extend(normals.into_iter().map(place_normal)),
            None => self.mesh.normals.extend(std::iter::repeat_n(Vec3::ZERO, count)),
        }
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

/// A positive multiple of the inverse transpose: the cofactor matrix with the determinant's sign, which also exists for singular
/// transforms.
fn inverse_transpose_direction(matrix: Mat3) -> DMat3 {
    let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|axis| axis.as_dvec3());
    let sign = if x.dot(y.cross(z)) < 0.0 { -1.0 } else { 1.0 };
    DMat3::from_cols(y.cross(z) * sign, z.cross(x) * sign, x.cross(y) * sign)
}

#[cfg(test)]
mod tests;
