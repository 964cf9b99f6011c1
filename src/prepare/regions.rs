//! Regions of binary images: opening and closing, the largest region, holes.

/// Whether each pixel belongs to the object, row by row from the top left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Bits {
    pub width: usize,
    pub height: usize,
    pub pixels: Vec<bool>,
}

impl Bits {
    pub fn count(&self) -> usize {
        self.pixels.iter().filter(|pixel| **pixel).count()
    }

    /// The longer side of the object's bounding box in pixels; 0 without an object.
    pub fn longer_side(&self) -> usize {
        let ones = || self.pixels.iter().enumerate().filter(|(_, one)| **one).map(|(i, _)| i);
        let side = |coordinates: &dyn Fn(usize) -> usize| {
            let (least, most) = (ones().map(coordinates).min(), ones().map(coordinates).max());
            least.zip(most).map_or(0, |(least, most)| most - least + 1)
        };
        side(&|i| i % self.width).max(side(&|i| i / self.width))
    }

    /// Dilation by a square of `2 radius + 1` pixels.
    pub fn dilated(&self, radius: usize) -> Self {
        self.spread(radius, true)
    }

    /// Erosion then dilation by a square of `2 radius + 1` pixels: takes away what is thinner.
    pub fn opened(&self, radius: usize) -> Self {
        self.spread(radius, false).spread(radius, true)
    }

    /// Dilation then erosion by a square of `2 radius + 1` pixels: closes what gaps are thinner.
    pub fn closed(&self, radius: usize) -> Self {
        // In a margin, so that the gap between object and frame is none.
        self.grown(radius).spread(radius, true).spread(radius, false).shrunk(radius)
    }

    /// With a margin of background on all sides.
    fn grown(&self, margin: usize) -> Self {
        let (width, height) = (self.width + 2 * margin, self.height + 2 * margin);
        let mut pixels = vec![false; width * height];
        for (y, row) in self.pixels.chunks_exact(self.width).enumerate() {
            let start = (y + margin) * width + margin;
            pixels[start..start + self.width].copy_from_slice(row);
        }
        Self { width, height, pixels }
    }

    /// Without a margin on all sides.
    fn shrunk(&self, margin: usize) -> Self {
        let (width, height) = (self.width - 2 * margin, self.height - 2 * margin);
        let rows = self.pixels.chunks_exact(self.width).skip(margin).take(height);
        let pixels = rows.flat_map(|row| &row[margin..margin + width]).copied().collect();
        Self { width, height, pixels }
    }

    /// Every pixel becomes `value` that has a pixel of that value within `radius`, along rows and then columns. What is outside the
    /// image has the other value.
    fn spread(&self, radius: usize, value: bool) -> Self {
        let (width, height) = (self.width, self.height);
        let mut rows = self.clone();
        for y in 0..height {
            spread_line(&self.pixels, &mut rows.pixels, y * width, 1, width, radius, value);
        }
        let mut both = rows.clone();
        for x in 0..width {
            spread_line(&rows.pixels, &mut both.pixels, x, width, height, radius, value);
        }
        both
    }

    /// The largest 4-connected region of the object; of equally large ones the first.
    pub fn largest_region(&self) -> Self {
        let (labels, sizes) = self.regions(true);
        let largest = (0..sizes.len()).max_by_key(|label| (sizes[*label], std::cmp::Reverse(*label)));
        let largest = largest.map(|label| label as u32);
        let pixels = labels.iter().map(|label| label.is_some() && *label == largest).collect();
        Self { pixels, ..*self }
    }

    /// The object with those of its holes that have at most `most` pixels. A hole is background that does not reach the frame.
    pub fn filled(&self, most: usize) -> Self {
        let (labels, sizes) = self.regions(false);
        let mut is_hole: Vec<bool> = sizes.iter().map(|size| *size <= most).collect();
        let (width, height) = (self.width, self.height);
        for (i, label) in labels.iter().enumerate() {
            let (x, y) = (i % width, i / width);
            if (x == 0 || y == 0 || x + 1 == width || y + 1 == height)
                && let Some(label) = *label
            {
                is_hole[label as usize] = false;
            }
        }
        let pixels = labels.iter().map(|label| label.is_none_or(|label| is_hole[label as usize])).collect();
        Self { pixels, ..*self }
    }

    /// The 4-connected region of each pixel that is `value`, and the regions' sizes.
    fn regions(&self, value: bool) -> (Vec<Option<u32>>, Vec<usize>) {
        let (mut labels, mut sizes) = (vec![None; self.pixels.len()], Vec::new());
        let mut waiting = Vec::new();
        for start in 0..self.pixels.len() {
            if self.pixels[start] != value || labels[start].is_some() {
                continue;
            }
            let label = sizes.len();
            sizes.push(0);
            labels[start] = Some(label as u32);
            waiting.push(start);
            while let Some(i) = waiting.pop() {
                sizes[label] += 1;
                for near in self.neighbors(i).into_iter().flatten() {
                    if self.pixels[near] == value && labels[near].is_none() {
                        labels[near] = Some(label as u32);
                        waiting.push(near);
                    }
                }
            }
        }
        (labels, sizes)
    }

    fn neighbors(&self, i: usize) -> [Option<usize>; 4] {
        let (x, y) = (i % self.width, i / self.width);
        [
            (x > 0).then(|| i - 1),
            (x + 1 < self.width).then(|| i + 1),
            (y > 0).then(|| i - self.width),
            (y + 1 < self.height).then(|| i + self.width),
        ]
    }
}

/// [`Bits::spread`] along one line of `length` pixels from `start`, `step` apart.
fn spread_line(
    from: &[bool],
    to: &mut [bool],
    start: usize,
    step: usize,
    length: usize,
    radius: usize,
    value: bool,
) {
    // The end of what is `value` because of the pixels so far.
    let mut until = 0;
    for i in 0..length {
        if from[start + i * step] == value {
            let first = i.saturating_sub(radius).max(until);
            until = (i + radius + 1).min(length);
            for k in first..until {
                to[start + k * step] = value;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bits(rows: &[&str]) -> Bits {
        let pixels = rows.iter().flat_map(|row| row.chars().map(|c| c == '#')).collect();
        Bits { width: rows[0].len(), height: rows.len(), pixels }
    }

    fn rows(bits: &Bits) -> Vec<String> {
        let char = |pixel: &bool| if *pixel { '#' } else { '.' };
        bits.pixels.chunks(bits.width).map(|row| row.iter().map(char).collect()).collect()
    }

    #[test]
    fn opening_takes_specks_and_closing_takes_gaps() {
        let specks = bits(&["#......", "..###..", "..###..", "..###..", "......#"]);
        assert_eq!(rows(&specks.opened(1)), [".......", "..###..", "..###..", "..###..", "......."]);
        let gap = bits(&[".......", ".##.##.", ".##.##.", ".##.##.", "......."]);
        assert_eq!(rows(&gap.closed(1)), [".......", ".#####.", ".#####.", ".#####.", "......."]);
        assert_eq!(specks.opened(0), specks);
    }

    /// An object that the frame cuts stays at the frame: what is outside neither erodes nor adds to it.
    #[test]
    fn the_frame_is_no_edge() {
        let cut = bits(&["###..", "###..", "###..", "....."]);
        assert_eq!(cut.opened(1), cut);
        assert_eq!(cut.closed(1), cut);
    }

    #[test]
    fn the_largest_region_stays_and_small_holes_go() {
        let two = bits(&["##.....", "##.####", "...#.##", "...####"]);
        let one = two.largest_region();
        assert_eq!(rows(&one), [".......", "...####", "...#.##", "...####"]);
        assert_eq!(rows(&one.filled(1)), [".......", "...####", "...####", "...####"]);
        assert_eq!(one.filled(0), one);
        assert_eq!(one.count(), 11);
        let nothing = bits(&["...", "..."]);
        assert_eq!(nothing.largest_region(), nothing);
        assert_eq!(nothing.filled(100), nothing);
    }
}
