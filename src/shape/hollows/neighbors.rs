//! The neighbors of a vertex in a grid.

/// The up to six neighbors of a vertex in a grid of `side` vertices along each axis.
pub fn neighbors(row: usize, side: u32) -> impl Iterator<Item = usize> {
    let side = side as usize;
    let along = [(1, row % side), (side, row / side % side), (side * side, row / (side * side))];
    along.into_iter().flat_map(move |(stride, at)| {
        [(at > 0).then(|| row - stride), (at + 1 < side).then(|| row + stride)].into_iter().flatten()
    })
}
