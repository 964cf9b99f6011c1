//! Which triangles make a chart: a tree of regions that merge, the cheapest pair first.
//!
//! Hierarchical face clustering (Garland, Willmott, Heckbert: "Hierarchical face clustering on
//! polygonal surfaces", I3D 2001) with the L²·¹ measure of flatness (Cohen-Steiner, Alliez,
//! Desbrun: "Variational shape approximation", SIGGRAPH 2004): a region of area A and summed area
//! vector N has the error A − |N|, half the integral of |n − N/|N||². A merge costs the error that
//! it adds, so small regions join others early and no specks remain.

use super::{NONE, Topology};
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

/// Largest error of a region per area: 0 is flat, 0.36 half a cylinder, 0.5 half a ball.
const MAX_BEND: f64 = 0.42;
/// Weight of squared perimeters, over 4π, against errors: straight seams and round charts.
const ROUNDNESS: f64 = 0.15;
/// How much dearer a merge becomes where the shared border is a crease, by 1 − cos of the angle
/// between normals there.
const CREASE: f64 = 4.0;
/// A crease on the inside hides a seam better than one on the outside.
const CONCAVE: f64 = 2.0;
/// Rounds in which normals become those of their neighborhood; the normals of a found mesh are
/// noisy.
const SMOOTHING_ROUNDS: usize = 5;

/// A node of the tree of regions: a triangle, or two nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RegionNode {
    /// One triangle.
    Triangle(u32),
    /// Two regions that share a border, by their nodes.
    Pair(u32, u32),
}

/// Trees of regions over all triangles with area.
#[derive(Debug)]
pub struct RegionTree {
    /// Nodes; those of a pair come before it.
    pub nodes: Vec<RegionNode>,
    /// Number of triangles of each node.
    pub counts: Vec<u32>,
    /// The largest regions.
    pub roots: Vec<u32>,
}

impl RegionTree {
    /// Merges regions as long as they are not too bent. Deterministic.
    pub fn new(topology: &Topology) -> Self {
        let mut merging = Merging::new(topology);
        // A pair that was too bent may be flat enough when the flat one of the two has grown.
        while merging.round() {}
        let roots = (0..merging.node.len()).filter(|&r| merging.alive[r]).map(|r| merging.node[r]).collect();
        let mut counts: Vec<u32> = Vec::with_capacity(merging.nodes.len());
        for node in &merging.nodes {
            counts.push(match *node {
                RegionNode::Triangle(_) => 1,
                RegionNode::Pair(a, b) => counts[a as usize] + counts[b as usize],
            });
        }
        Self { nodes: merging.nodes, counts, roots }
    }

    /// The triangles of a node, in ascending order.
    pub fn triangles(&self, node: u32) -> Vec<u32> {
        let (mut found, mut open) = (Vec::new(), vec![node]);
        while let Some(node) = open.pop() {
            match self.nodes[node as usize] {
                RegionNode::Triangle(triangle) => found.push(triangle),
                RegionNode::Pair(a, b) => open.extend([a, b]),
            }
        }
        found.sort_unstable();
        found
    }
}

/// Shared border of two regions.
#[derive(Clone, Copy, Debug, Default)]
struct Border {
    /// Length, world units.
    length: f64,
    /// Integral of the crease along it.
    crease: f64,
    /// The one valid entry in the queue, if it has one.
    entry: u32,
}

/// Two regions, the one of the lower number first.
type RegionPair = (u32, u32);

fn pair(a: u32, b: u32) -> RegionPair {
    (a.min(b), a.max(b))
}

/// A pair of regions that may merge: cost ([`order_of`]), number of the entry, so that of equal
/// costs the oldest comes first, and pair.
type Candidate = Reverse<(i64, u32, RegionPair)>;

/// A number that is ordered as the cost is, by its bits (see [`f64::total_cmp`]).
fn order_of(cost: f64) -> i64 {
    let bits = cost.to_bits() as i64;
    bits ^ (((bits >> 63) as u64) >> 1) as i64
}

/// Regions while they merge; a region is named by one of its triangles.
struct Merging {
    nodes: Vec<RegionNode>,
    /// The region's node.
    node: Vec<u32>,
    alive: Vec<bool>,
    area: Vec<f64>,
    /// Sum of the area vectors.
    normal: Vec<DVec3>,
    perimeter: Vec<f64>,
    /// Regions that share a border, and some that are no more.
    neighbors: Vec<Vec<u32>>,
    borders: HashMap<RegionPair, Border>,
    queue: BinaryHeap<Candidate>,
    next_entry: u32,
}

impl Merging {
    fn new(topology: &Topology) -> Self {
        let count = topology.triangles.len();
        let area: Vec<f64> = topology.area_vectors.iter().map(|v| v.length()).collect();
        let perimeter = (0..count as u32).map(|t| (0..3).map(|k| topology.edge_length(t, k)).sum()).collect();
        let normals = smoothed_normals(topology, &area);
        let node: Vec<u32> = (0..count as u32).collect();
        let nodes = node.iter().copied().map(RegionNode::Triangle).collect();
        let alive = node.iter().map(|t| topology.has_area(*t)).collect();
        let normal = normals.iter().zip(&area).map(|(n, a)| *n * *a).collect();
        let (neighbors, borders) = (vec![Vec::new(); count], HashMap::with_capacity(2 * count));
        let (queue, next_entry) = (BinaryHeap::new(), 0);
        let mut merging =
            Self { nodes, node, alive, area, normal, perimeter, neighbors, borders, queue, next_entry };
        for t in 0..count as u32 {
            for (k, &other) in topology.neighbors[t as usize].iter().enumerate() {
                if other == NONE || t >= other {
                    continue;
                }
                let length = topology.edge_length(t, k);
                let border = merging.borders.entry((t, other)).or_default();
                border.length += length;
                border.crease += length * crease(topology, t, other);
                for (a, b) in [(t, other), (other, t)] {
                    if !merging.neighbors[a as usize].contains(&b) {
                        merging.neighbors[a as usize].push(b);
                    }
                }
            }
        }
        merging
    }

    /// Cost of merging two regions that share `border`; `None` if the result is too bent.
    fn cost(&self, (a, b): RegionPair, border: &Border) -> Option<f64> {
        let (a, b) = (a as usize, b as usize);
        let area = self.area[a] + self.area[b];
        let length = (self.normal[a] + self.normal[b]).length();
        if area - length > MAX_BEND * area {
            return None;
        }
        let error = self.normal[a].length() + self.normal[b].length() - length;
        let perimeter = self.perimeter[a] + self.perimeter[b] - 2.0 * border.length;
        let squares = perimeter.powi(2) - self.perimeter[a].powi(2) - self.perimeter[b].powi(2);
        let crease = border.crease / border.length;
        Some(error * (1.0 + CREASE * crease) + ROUNDNESS / (4.0 * std::f64::consts::PI) * squares)
    }

    /// Puts a pair into the queue, if it may merge.
    fn queue(&mut self, pair: RegionPair) {
        self.next_entry += 1;
        let id = self.next_entry;
        let Some(border) = self.borders.get_mut(&pair) else { return };
        border.entry = id;
        let border = *border;
        if let Some(cost) = self.cost(pair, &border) {
            self.queue.push(Reverse((order_of(cost), id, pair)));
        }
    }

    /// Puts all pairs into the queue, and merges until it is empty; whether anything was merged.
    fn round(&mut self) -> bool {
        for a in 0..self.alive.len() {
            for i in 0..self.neighbors[a].len() {
                let b = self.neighbors[a][i];
                if self.alive[a] && (a as u32) < b && self.alive[b as usize] {
                    self.queue((a as u32, b));
                }
            }
        }
        let mut any = false;
        while let Some(Reverse((cost, id, pair))) = self.queue.pop() {
            let border = self.borders.get(&pair).copied().filter(|border| border.entry == id);
            let Some(border) = border else { continue };
            // Both may have grown since the entry was made: costs are looked at again only here.
            match self.cost(pair, &border) {
                Some(now) if order_of(now) > cost => self.queue(pair),
                Some(_) => {
                    self.merge(pair, &border);
                    any = true;
                }
                None => {}
            }
        }
        any
    }

    fn merge(&mut self, (a, b): RegionPair, border: &Border) {
        // The one with fewer neighbors goes into the other.
        let small_first = self.neighbors[a as usize].len() < self.neighbors[b as usize].len();
        let (kept, gone) = if small_first { (b as usize, a as usize) } else { (a as usize, b as usize) };
        self.nodes.push(RegionNode::Pair(self.node[kept], self.node[gone]));
        self.node[kept] = self.nodes.len() as u32 - 1;
        self.alive[gone] = false;
        self.area[kept] += self.area[gone];
        let normal = self.normal[gone];
        self.normal[kept] += normal;
        self.perimeter[kept] += self.perimeter[gone] - 2.0 * border.length;
        self.borders.remove(&(a, b));
        for other in std::mem::take(&mut self.neighbors[gone]) {
            if !self.alive[other as usize] || other as usize == kept {
                continue;
            }
            let Some(border) = self.borders.remove(&pair(gone as u32, other)) else { continue };
            let pair = pair(kept as u32, other);
            if let Some(shared) = self.borders.get_mut(&pair) {
                shared.length += border.length;
                shared.crease += border.crease;
            } else {
                self.borders.insert(pair, border);
                self.neighbors[kept].push(other);
                self.neighbors[other as usize].push(kept as u32);
            }
            self.queue(pair);
        }
    }
}

/// Unit normals, each a mean over neighbors that face about the same way.
fn smoothed_normals(topology: &Topology, area: &[f64]) -> Vec<DVec3> {
    let mut normals: Vec<DVec3> = topology.area_vectors.iter().map(|v| v.normalize_or_zero()).collect();
    for _ in 0..SMOOTHING_ROUNDS {
        let smooth = |t: usize| {
            let mut sum = normals[t] * area[t];
            for &other in topology.neighbors[t].iter().filter(|other| **other != NONE) {
                let alike = normals[t].dot(normals[other as usize]).max(0.0);
                sum += normals[other as usize] * (area[other as usize] * alike * alike);
            }
            sum.normalize_or_zero()
        };
        normals = (0..normals.len()).map(smooth).collect();
    }
    normals
}

/// How sharp the edge between two triangles is, 0 where they are flat; more where it is on the
/// inside.
fn crease(topology: &Topology, t: u32, other: u32) -> f64 {
    let [normal, across] = [t, other].map(|t| topology.area_vectors[t as usize].normalize_or_zero());
    let middle = |t: u32| topology.corners(t).into_iter().sum::<DVec3>() / 3.0;
    let concave = (middle(other) - middle(t)).dot(normal) > 0.0;
    (1.0 - normal.dot(across)) * if concave { CONCAVE } else { 1.0 }
}
