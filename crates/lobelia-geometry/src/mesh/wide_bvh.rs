//! A bounding volume hierarchy with eight children a node, and eight triangles a leaf, for one ray
//! or a packet of them: the boxes of a node, or the triangles of a leaf, are tested at once.
//!
//! Source: Wald, Benthin and Boulos, "Getting Rid of Packets" (2008): wide nodes by opening the
//! largest children of a binary hierarchy.

use crate::mesh::triangles::Mesh;
use fearless_simd::{Simd, f32x8, prelude::*};
use obvhs::bvh2::Bvh2;

/// Children of a node, and triangles of a leaf.
pub(super) const WIDTH: usize = 8;
/// A child that is a leaf has this bit.
const LEAF: u32 = 1 << 31;
/// Nodes that wait in the usual case; more are kept on the heap.
const USUAL_WAITING: usize = 64;
/// A direction's component below this counts as this, so that its inverse is finite.
const LEAST_COMPONENT: f32 = 1e-30;
/// Boxes are left this much later, for rounding in the box test (Ize, "Robust BVH Ray Traversal",
/// 2013: 2γ₃).
pub(super) const ROUNDING: f32 = 1.0 + 8e-7;

/// One value for each child of a node or triangle of a leaf.
pub(super) type Each = [f32; WIDTH];

/// Least and greatest corner of a box.
pub(super) type BoxCorners = [[f32; 3]; 2];

/// The boxes around the children of a node. Boxes of missing children have their low corner beyond
/// their high one.
#[derive(Clone, Debug, PartialEq)]
#[repr(C, align(32))]
struct Node {
    /// Low corners, high corners: x, y and z of all children.
    bounds: [[Each; 3]; 2],
    /// Numbers of nodes, or with [`LEAF`] of leaves.
    children: [u32; WIDTH],
    /// The box around all of them.
    around: BoxCorners,
}

/// Up to eight triangles; missing ones are zero, and `count` leaves them out.
#[derive(Clone, Debug, PartialEq)]
#[repr(C, align(32))]
pub(super) struct Leaf {
    /// x, y and z of the three corners.
    pub corners: [[Each; 3]; 3],
    /// Indices of the triangles.
    pub triangles: [u32; WIDTH],
    /// How many there are.
    pub count: u32,
    /// The box around them.
    pub around: BoxCorners,
}

/// The hierarchy.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct WideBvh {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
}

/// One ray, or several that start at one point, as boxes are tested against them.
pub(super) trait BoxRays {
    /// Distances at which the rays meet the nearer and the farther plane of each box along an axis:
    /// of several rays the least and the greatest.
    fn planes<S: Simd>(&self, simd: S, bounds: &[[Each; 3]; 2], axis: usize) -> (f32x8<S>, f32x8<S>);
}

/// A ray as boxes are tested against it.
pub(super) struct BoxRay {
    pub origin: [f32; 3],
    /// Inverse components of the direction ([`inverse`]).
    pub inverse: [f32; 3],
}

/// The inverse of a direction's component, finite.
pub(super) fn inverse(component: f32) -> f32 {
    component.abs().max(LEAST_COMPONENT).copysign(component).recip()
}

impl BoxRays for BoxRay {
    #[inline(always)]
    fn planes<S: Simd>(&self, simd: S, bounds: &[[Each; 3]; 2], axis: usize) -> (f32x8<S>, f32x8<S>) {
        let origin = f32x8::splat(simd, self.origin[axis]);
        let inverse = f32x8::splat(simd, self.inverse[axis]);
        let near = usize::from(self.inverse[axis] < 0.0);
        let low = f32x8::from_slice(simd, &bounds[near][axis]);
        let high = f32x8::from_slice(simd, &bounds[1 - near][axis]);
        ((low - origin) * inverse, (high - origin) * inverse)
    }
}

/// Operations on the leaves along a ray.
pub(super) trait LeafVisitor {
    /// Whether any of the rays may enter a box; the contents of a box that none enters are skipped.
    /// Called with the box of a leaf right before the visit of the leaf. One ray is tested against
    /// the children of a node, and that is all.
    #[inline(always)]
    fn enters<S: Simd>(&mut self, _simd: S, _around: &BoxCorners) -> bool {
        true
    }

    /// Sees a leaf that the ray enters before `limit`; returns the limit from then on.
    fn visit<S: Simd>(&mut self, simd: S, leaf: &Leaf, limit: f32) -> f32;
}

/// Nodes that wait for their turn, with the least distances at which rays enter them.
struct Waiting {
    few: [(f32, u32); USUAL_WAITING],
    count: usize,
    more: Vec<(f32, u32)>,
}

impl Waiting {
    #[inline(always)]
    fn new() -> Self {
        Self { few: [(0.0, 0); USUAL_WAITING], count: 0, more: Vec::new() }
    }

    #[inline(always)]
    fn pop(&mut self) -> Option<(f32, u32)> {
        if let Some(last) = self.more.pop() {
            return Some(last);
        }
        self.count = self.count.checked_sub(1)?;
        Some(self.few[self.count])
    }

    /// Adds the children whose bits are set, so that the nearest is the next one.
    #[inline(always)]
    fn push(&mut self, mut bits: u64, entry: &Each, children: &[u32; WIDTH]) {
        if self.count + WIDTH > USUAL_WAITING {
            return self.push_more(bits, entry, children);
        }
        let first = self.count;
        while bits != 0 {
            let child = bits.trailing_zeros() as usize & (WIDTH - 1);
            bits &= bits - 1;
            let mut at = self.count;
            while at > first && self.few[at - 1].0 < entry[child] {
                self.few[at] = self.few[at - 1];
                at -= 1;
            }
            self.few[at] = (entry[child], children[child]);
            self.count += 1;
        }
    }

    #[cold]
    fn push_more(&mut self, bits: u64, entry: &Each, children: &[u32; WIDTH]) {
        let first = self.more.len();
        let hit = (0..WIDTH).filter(|child| bits >> child & 1 == 1);
        self.more.extend(hit.map(|child| (entry[child], children[child])));
        self.more[first..].sort_by(|a, b| b.0.total_cmp(&a.0));
    }
}

impl WideBvh {
    /// From a binary hierarchy over the triangles of a mesh.
    pub fn new(binary: &Bvh2, mesh: &Mesh) -> Self {
        if binary.nodes.is_empty() || binary.primitive_indices.is_empty() {
            return Self::default();
        }
        let mut builder = Builder { binary, counts: triangle_counts(binary), mesh, leaves: Vec::new() };
        let (mut nodes, mut open) = (vec![Node::EMPTY], vec![(0, 0)]);
        while let Some((index, place)) = open.pop() {
            let mut node = Node { around: builder.around(index), ..Node::EMPTY };
            for (k, child) in builder.children(index).into_iter().enumerate() {
                for (bounds, corner) in node.bounds.iter_mut().zip(builder.around(child)) {
                    bounds.iter_mut().zip(corner).for_each(|(each, c)| each[k] = c);
                }
                node.children[k] = if builder.is_leaf(child) {
                    builder.leaf(child)
                } else {
                    open.push((child, nodes.len()));
                    nodes.push(Node::EMPTY);
                    nodes.len() as u32 - 1
                };
            }
            nodes[place] = node;
        }
        Self { nodes, leaves: builder.leaves }
    }

    /// Visits the leaves whose boxes the rays enter before `limit`, near ones first.
    #[inline(always)]
    pub fn walk<S: Simd>(
        &self,
        simd: S,
        rays: &impl BoxRays,
        mut limit: f32,
        visitor: &mut impl LeafVisitor,
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let mut waiting = Waiting::new();
        let (mut entered, mut next) = (0.0, 0);
        loop {
            if entered < limit {
                if next & LEAF != 0 {
                    let leaf = &self.leaves[(next & !LEAF) as usize];
                    if visitor.enters(simd, &leaf.around) {
                        limit = visitor.visit(simd, leaf, limit);
                        if limit <= 0.0 {
                            return;
                        }
                    }
                } else {
                    let node = &self.nodes[next as usize];
                    if visitor.enters(simd, &node.around) {
                        let (bits, entries) = node.entered(simd, rays, limit);
                        waiting.push(bits, &entries, &node.children);
                    }
                }
            }
            match waiting.pop() {
                Some(waited) => (entered, next) = waited,
                None => return,
            }
        }
    }
}

/// How many triangles are below each node.
fn triangle_counts(binary: &Bvh2) -> Vec<u32> {
    let mut counts = vec![0; binary.nodes.len()];
    // Children are counted before their parents: each node is seen twice.
    let mut open = vec![(0, false)];
    while let Some((index, is_counted)) = open.pop() {
        let node = &binary.nodes[index];
        let first = node.first_index as usize;
        if node.is_leaf() {
            counts[index] = node.prim_count;
        } else if is_counted {
            counts[index] = counts[first] + counts[first + 1];
        } else {
            open.extend([(index, true), (first, false), (first + 1, false)]);
        }
    }
    counts
}

struct Builder<'a> {
    binary: &'a Bvh2,
    counts: Vec<u32>,
    mesh: &'a Mesh,
    leaves: Vec<Leaf>,
}

impl Builder<'_> {
    fn is_leaf(&self, index: usize) -> bool {
        self.counts[index] as usize <= WIDTH || self.binary.nodes[index].is_leaf()
    }

    /// Up to eight nodes that cover what is below a node: its largest children are opened.
    fn children(&self, index: usize) -> Vec<usize> {
        let mut children = vec![index];
        while children.len() < WIDTH {
            let area = |child: usize| self.binary.nodes[child].aabb().half_area();
            let inner = (0..children.len()).filter(|k| !self.is_leaf(children[*k]));
            let largest = inner.max_by(|a, b| area(children[*a]).total_cmp(&area(children[*b])));
            let Some(k) = largest else { break };
            let first = self.binary.nodes[children[k]].first_index as usize;
            children[k] = first;
            children.push(first + 1);
        }
        children
    }

    fn around(&self, index: usize) -> BoxCorners {
        let aabb = self.binary.nodes[index].aabb();
        [aabb.min.to_array(), aabb.max.to_array()]
    }

    /// Adds a leaf of the triangles below a node.
    fn leaf(&mut self, index: usize) -> u32 {
        let mut triangles = Vec::with_capacity(WIDTH);
        let mut open = vec![index];
        while let Some(index) = open.pop() {
            let node = &self.binary.nodes[index];
            let first = node.first_index as usize;
            if node.is_leaf() {
                triangles.extend(&self.binary.primitive_indices[first..first + node.prim_count as usize]);
            } else {
                open.extend([first + 1, first]);
            }
        }
        let (count, around) = (triangles.len() as u32, self.around(index));
        let mut leaf = Leaf { corners: Default::default(), triangles: [u32::MAX; WIDTH], count, around };
        for (lane, triangle) in triangles.iter().enumerate() {
            leaf.triangles[lane] = *triangle;
            for (of, corner) in leaf.corners.iter_mut().zip(self.mesh.corners(*triangle as usize)) {
                of.iter_mut().zip(corner.to_array()).for_each(|(each, c)| each[lane] = c);
            }
        }
        self.leaves.push(leaf);
        LEAF | (self.leaves.len() as u32 - 1)
    }
}

impl Node {
    /// A bit for each child that the rays enter before `limit`, and the distances at which they
    /// enter.
    #[inline(always)]
    fn entered<S: Simd>(&self, simd: S, rays: &impl BoxRays, limit: f32) -> (u64, Each) {
        let (near_x, far_x) = rays.planes(simd, &self.bounds, 0);
        let (near_y, far_y) = rays.planes(simd, &self.bounds, 1);
        let (near_z, far_z) = rays.planes(simd, &self.bounds, 2);
        let entry = near_x.max(near_y).max(near_z.max(f32x8::splat(simd, 0.0)));
        let exit = far_x.min(far_y).min(far_z) * f32x8::splat(simd, ROUNDING);
        let bits = entry.simd_le(exit.min(f32x8::splat(simd, limit))).to_bitmask();
        let mut entries = [0.0; WIDTH];
        entry.store_slice(&mut entries);
        (bits, entries)
    }

    const EMPTY: Self = Self {
        bounds: [[[f32::INFINITY; WIDTH]; 3], [[f32::NEG_INFINITY; WIDTH]; 3]],
        children: [0; WIDTH],
        around: [[0.0; 3]; 2],
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_waits_comes_back_nearest_first_however_much_it_is() {
        let mut waiting = Waiting::new();
        let entries: Each = [5.0, 1.0, 7.0, 3.0, 0.0, 6.0, 2.0, 4.0];
        let numbers = |round: u32| std::array::from_fn(|k| 10 * round + k as u32);
        // All children but the fifth, and more than there is room for without the heap.
        (0..20).for_each(|round| waiting.push(0b1110_1111, &entries, &numbers(round)));
        for round in (0..20).rev() {
            let sorted: Vec<u32> = (0..7).map(|_| waiting.pop().unwrap().1 - 10 * round).collect();
            assert_eq!(sorted, [1, 6, 3, 7, 0, 5, 2]);
        }
        assert_eq!(waiting.pop(), None);
    }
}
