//! [`Real`] for a SIMD vector of `f32`, at whatever width the machine has at run time.

use crate::real::Real;
use fearless_simd::prelude::*;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

/// A native-width vector of `f32` with its level token.
#[derive(Clone, Copy)]
pub struct Lanes<S: Simd> {
    value: S::f32s,
    simd: S,
}

impl<S: Simd> Lanes<S> {
    /// Lanes in one vector; always divides [`MAX_LANES`].
    pub const LEN: usize = <S::f32s as SimdBase<S>>::LEN;

    /// Broadcasts a value to every lane.
    #[inline(always)]
    pub fn splat(simd: S, value: f32) -> Self {
        Self { value: value.simd_into(simd), simd }
    }

    /// Lanes from a slice of exactly [`Self::LEN`] values.
    #[inline(always)]
    pub fn load(simd: S, slice: &[f32]) -> Self {
        Self { value: S::f32s::from_slice(simd, slice), simd }
    }

    /// Lanes from a slice of exactly [`Self::LEN`] values, 0 to 255 for 0 to 1.
    #[inline(always)]
    pub fn parts(simd: S, slice: &[u8]) -> Self {
        let mut values = Row::ZERO;
        for (value, part) in values.0[..Self::LEN].iter_mut().zip(&slice[..Self::LEN]) {
            *value = f32::from(*part) * (1.0 / 255.0);
        }
        Self::load(simd, &values.0[..Self::LEN])
    }

    /// Adds the lanes onto a slice of exactly [`Self::LEN`] values.
    #[inline(always)]
    pub fn add_to(self, slice: &mut [f32]) {
        (S::f32s::from_slice(self.simd, slice) + self.value).store_slice(slice);
    }

    /// Writes the lanes to a slice of exactly [`Self::LEN`] values.
    #[inline(always)]
    pub fn store(self, slice: &mut [f32]) {
        self.value.store_slice(slice);
    }

    /// The value of one lane.
    #[inline(always)]
    pub fn lane(&self, index: usize) -> f32 {
        self.value.as_slice()[index]
    }

    /// 0, 1, 2 …
    #[inline(always)]
    pub fn counting(simd: S) -> Self {
        const COUNT: [f32; MAX_LANES] =
            [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];
        Self::load(simd, &COUNT[..Self::LEN])
    }

    /// Value `i` of every record of [`RECORD`] values, from one record per lane.
    #[inline(always)]
    pub fn columns(simd: S, records: &[[f32; RECORD]; MAX_LANES]) -> [Self; RECORD] {
        let values = records.as_flattened();
        let mut v = [S::f32s::splat(simd, 0.0); RECORD];
        for (i, v) in v.iter_mut().enumerate() {
            *v = S::f32s::from_slice(simd, &values[i * Self::LEN..(i + 1) * Self::LEN]);
        }
        // Even values in front of odd ones, three times: by the three bits of their place in the
        // record.
        let [a, b, c, d] =
            [v[0].unzip_low(v[1]), v[2].unzip_low(v[3]), v[4].unzip_low(v[5]), v[6].unzip_low(v[7])];
        let [e, f, g, h] =
            [v[0].unzip_high(v[1]), v[2].unzip_high(v[3]), v[4].unzip_high(v[5]), v[6].unzip_high(v[7])];
        let (even, odd) = ([a.unzip_low(b), c.unzip_low(d)], [a.unzip_high(b), c.unzip_high(d)]);
        let (even_1, odd_1) = ([e.unzip_low(f), g.unzip_low(h)], [e.unzip_high(f), g.unzip_high(h)]);
        let lanes = |value| Self { value, simd };
        [
            lanes(even[0].unzip_low(even[1])),
            lanes(even_1[0].unzip_low(even_1[1])),
            lanes(odd[0].unzip_low(odd[1])),
            lanes(odd_1[0].unzip_low(odd_1[1])),
            lanes(even[0].unzip_high(even[1])),
            lanes(even_1[0].unzip_high(even_1[1])),
            lanes(odd[0].unzip_high(odd[1])),
            lanes(odd_1[0].unzip_high(odd_1[1])),
        ]
    }

    /// One record of [`RECORD`] values per lane, one after another ([`record_of`]), from value `i`
    /// of all of them; undoes [`Lanes::columns`].
    #[inline(always)]
    pub fn records(columns: [Self; RECORD]) -> [Row; RECORD] {
        let [a, b, c, d, e, f, g, h] = columns;
        let (a, b, c, d) = (a.value, b.value, c.value, d.value);
        let (e, f, g, h) = (e.value, f.value, g.value, h.value);
        // Values of two columns in turn, three times: by the three bits of their number.
        let [ae, bf, cg, dh] = [a.interleave(e), b.interleave(f), c.interleave(g), d.interleave(h)];
        let [even, odd] = [ae.0.interleave(cg.0), bf.0.interleave(dh.0)];
        let [even_1, odd_1] = [ae.1.interleave(cg.1), bf.1.interleave(dh.1)];
        let pairs = [
            even.0.interleave(odd.0),
            even.1.interleave(odd.1),
            even_1.0.interleave(odd_1.0),
            even_1.1.interleave(odd_1.1),
        ];
        let mut rows = [Row::ZERO; RECORD];
        for (i, (first, second)) in pairs.into_iter().enumerate() {
            store_at::<S>(&mut rows, 2 * i * Self::LEN, first);
            store_at::<S>(&mut rows, (2 * i + 1) * Self::LEN, second);
        }
        rows
    }

    /// The lanes whose bits are set, in order in the lowest lanes; zero in the others.
    #[inline(always)]
    pub fn packed(self, bits: u64) -> Self {
        let mask = S::mask32s::from_bitmask(self.simd, bits);
        Self { value: self.value.compress(mask), simd: self.simd }
    }

    /// Bit i is set where lane i is below `bound`'s.
    #[inline(always)]
    pub fn bits_below(self, bound: Self) -> u64 {
        self.value.simd_lt(bound.value).to_bitmask()
    }

    /// e to the power of arguments in [−87, 88]: Cody–Waite reduction to |r| ≤ ln 2/2 and a minimax
    /// polynomial of degree 5, with a relative error below 2e-7.
    #[inline(always)]
    fn exp_between(self) -> Self {
        // Adding 1.5·2²³ rounds to an integer and leaves it in the low bits, ready to be an
        // exponent.
        let rounder = self.lit(12_582_912.0);
        let shifted = self.mul_add(self.lit(std::f64::consts::LOG2_E), rounder);
        let k = shifted - rounder;
        let r = k.mul_add(self.lit(-0.693_359_375), self);
        let r = k.mul_add(self.lit(2.121_944_4e-4), r);
        let mut p = self.lit(8.312_501e-3);
        for c in [4.189_033e-2, 0.166_671_16, 0.499_992_3, 1.0, 1.0] {
            p = p.mul_add(r, self.lit(c));
        }
        let exponent: S::i32s = shifted.value.bitcast();
        let bits: S::i32s = p.value.bitcast();
        Self { value: (bits + (exponent << 23)).bitcast(), simd: self.simd }
    }

    /// Sum of the lanes, in an order that depends on the vector width only.
    #[inline(always)]
    pub fn sum(self) -> f32 {
        self.value.reduce_sum()
    }
}

/// `$body` with `$simd` the token of the best instruction set that this machine has, or that `$level`
/// names.
///
/// Like the macro of this name in fearless_simd, but without SSE4.2, where kernels do the same
/// operations as with SSE2.
#[macro_export]
macro_rules! dispatch {
    ($level:expr, $simd:pat => $body:expr) => {{
        let level: fearless_simd::Level = $level;
        #[cfg(target_arch = "x86_64")]
        {
            if let Some(token) = level.as_avx512() {
                $crate::with_token!(token, $simd => $body)
            } else if let Some(token) = level.as_avx2() {
                $crate::with_token!(token, $simd => $body)
            } else {
                let token = level.as_sse2().expect("every x86-64 has SSE2");
                $crate::with_token!(token, $simd => $body)
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            fearless_simd::dispatch!(level, $simd => $body)
        }
    }};
    ($simd:pat => $body:expr) => {
        $crate::dispatch!(fearless_simd::Level::new(), $simd => $body)
    };
}

/// `$body` compiled with the instructions of `$token`.
#[cfg(target_arch = "x86_64")]
#[doc(hidden)]
#[macro_export]
macro_rules! with_token {
    ($token:expr, $simd:pat => $body:expr) => {{
        let token = $token;
        let $simd = token;
        fearless_simd::Simd::vectorize(
            token,
            #[inline(always)]
            || $body,
        )
    }};
}

/// The instruction set that kernels choose on this machine.
pub fn level_name() -> &'static str {
    /// A function that is generic over the level, like the kernels.
    #[inline(always)]
    fn name<S: Simd>(_simd: S) -> &'static str {
        let path = std::any::type_name::<S>();
        path.rsplit("::").next().unwrap_or(path)
    }
    dispatch!(simd => name(simd))
}

/// Number of lanes of the widest vector of any level; buffers are padded to multiples of it.
pub const MAX_LANES: usize = 16;

/// Values of a record in [`Lanes::columns`].
pub const RECORD: usize = 8;

/// Values of one vector of the widest level, aligned to a cache line.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Row(pub [f32; MAX_LANES]);

impl Row {
    /// All zero.
    pub const ZERO: Self = Self([0.0; MAX_LANES]);
}

/// Writes a vector to rows that follow each other, from this value on.
#[inline(always)]
fn store_at<S: Simd>(rows: &mut [Row], at: usize, vector: S::f32s) {
    let row = &mut rows[at / MAX_LANES].0;
    vector.store_slice(&mut row[at % MAX_LANES..][..Lanes::<S>::LEN]);
}

/// A record among rows of them.
#[inline(always)]
pub fn record_of(rows: &[Row], record: usize) -> &[f32] {
    &rows[record * RECORD / MAX_LANES].0[record * RECORD % MAX_LANES..][..RECORD]
}

/// [`record_of`], to be changed.
#[inline(always)]
pub fn record_of_mut(rows: &mut [Row], record: usize) -> &mut [f32] {
    &mut rows[record * RECORD / MAX_LANES].0[record * RECORD % MAX_LANES..][..RECORD]
}

macro_rules! binary {
    ($op:ident, $method:ident) => {
        impl<S: Simd> $op for Lanes<S> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self { value: $op::$method(self.value, other.value), simd: self.simd }
            }
        }
    };
}
binary!(Add, add);
binary!(Sub, sub);
binary!(Mul, mul);
binary!(Div, div);

impl<S: Simd> AddAssign for Lanes<S> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        self.value += other.value;
    }
}

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self { value: -self.value, simd: self.simd }
    }
}

impl<S: Simd> Real for Lanes<S> {
    #[inline(always)]
    fn lit(self, value: f64) -> Self {
        Self::splat(self.simd, value as f32)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self { value: self.value.sqrt(), simd: self.simd }
    }
    /// `exp_between` for arguments in [−87, 88]; those beyond are clamped, so the result is finite
    /// and never below 1e-38.
    #[inline(always)]
    fn exp(self) -> Self {
        self.max(self.lit(-87.0)).min(self.lit(88.0)).exp_between()
    }
    #[inline(always)]
    fn decay(self) -> Self {
        self.max(self.lit(-50.0)).exp_between()
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self { value: self.value.max(other.value), simd: self.simd }
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self { value: self.value.min(other.value), simd: self.simd }
    }
    #[inline(always)]
    fn select_lt(self, bound: Self, yes: Self, no: Self) -> Self {
        Self { value: self.value.simd_lt(bound.value).select(yes.value, no.value), simd: self.simd }
    }
    #[inline(always)]
    fn any_lt(self, bound: Self) -> bool {
        self.value.simd_lt(bound.value).any_true()
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self { value: self.value.abs(), simd: self.simd }
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        Self { value: self.value.copysign(sign.value), simd: self.simd }
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        Self { value: self.value.mul_add(a.value, b.value), simd: self.simd }
    }
    /// The hardware's estimate (at least 12 bits on x86-64, 8 on aarch64) and one or two Newton
    /// steps.
    #[inline(always)]
    fn inverse(self) -> Self {
        let two = self.lit(2.0);
        let mut y = Self { value: self.value.approximate_recip(), simd: self.simd };
        let steps = if cfg!(target_arch = "aarch64") { 2 } else { 1 };
        for _ in 0..steps {
            y = y * (-self).mul_add(y, two);
        }
        y
    }
    /// A Newton step more than the rough one: relative error below 5e-6.
    #[inline(always)]
    fn quick_rsqrt(self) -> Self {
        let y = self.rough_rsqrt();
        y * (self * self.lit(-0.5) * y).mul_add(y, self.lit(1.5))
    }
    /// From half the exponent and a Newton step: relative error below 2e-3.
    #[inline(always)]
    fn rough_rsqrt(self) -> Self {
        let bits: S::i32s = self.value.bitcast();
        let halved = -(bits >> 1) + 0x5f37_59df;
        let y = Self { value: halved.bitcast(), simd: self.simd };
        y * (self * self.lit(-0.5) * y).mul_add(y, self.lit(1.5))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[inline(always)]
    fn each<S: Simd>(simd: S, values: &mut [f32], of: impl Fn(Lanes<S>) -> Lanes<S>) {
        for chunk in values.chunks_exact_mut(Lanes::<S>::LEN) {
            let result = of(Lanes::load(simd, chunk));
            chunk.fill(0.0);
            result.add_to(chunk);
        }
    }

    /// The columns of one record per lane, and the records that these become again.
    #[inline(always)]
    fn there_and_back<S: Simd>(simd: S, records: &[[f32; RECORD]; MAX_LANES]) -> [Vec<Vec<f32>>; 2] {
        let columns = Lanes::columns(simd, records);
        let (rows, lanes) = (Lanes::records(columns), || 0..Lanes::<S>::LEN);
        let columns = columns.iter().map(|column| lanes().map(|lane| column.lane(lane)).collect());
        [columns.collect(), lanes().map(|lane| record_of(&rows, lane).to_vec()).collect()]
    }

    #[test]
    fn records_become_columns_and_records_again() {
        let records = std::array::from_fn(|i| std::array::from_fn(|c| (10 * i + c) as f32));
        let [columns, again] = dispatch!(simd => there_and_back(simd, &records));
        for (c, column) in columns.iter().enumerate() {
            assert!(column.iter().zip(&records).all(|(value, record)| *value == record[c]), "{column:?}");
        }
        assert!(again.iter().zip(&records).all(|(again, record)| again == record), "{again:?}");
    }

    #[inline(always)]
    fn pack_all<S: Simd>(simd: S, bits: u64) -> Vec<f32> {
        let packed = Lanes::counting(simd).packed(bits);
        (0..Lanes::<S>::LEN).map(|i| packed.lane(i)).collect()
    }

    #[test]
    fn selected_lanes_are_packed_in_order() {
        for bits in [0b0000, 0b1010, 0b0111, 0b1001] {
            let packed = dispatch!(simd => pack_all(simd, bits));
            let expected = (0..4u8).filter(|i| bits >> i & 1 == 1).map(f32::from);
            let expected: Vec<f32> = expected.chain(std::iter::repeat(0.0)).take(packed.len()).collect();
            assert_eq!(packed, expected, "{bits:b}");
        }
    }

    #[test]
    fn inverse_is_within_its_stated_error() {
        let inputs: Vec<f32> = (0..16_000).map(|i| 10f32.powf(-37.0 + 74.0 * i as f32 / 15_999.0)).collect();
        let mut outputs = inputs.clone();
        dispatch!(simd => each(simd, &mut outputs, Real::inverse));
        for (x, y) in inputs.iter().zip(&outputs) {
            let product = f64::from(*x) * f64::from(*y);
            assert!((product - 1.0).abs() < 3e-7, "1/{x} = {y}");
        }
    }

    #[test]
    fn exp_is_within_its_stated_error() {
        let inputs: Vec<f32> = (0..16_000).map(|i| -87.0 + 174.0 * i as f32 / 15_999.0).collect();
        let mut outputs = inputs.clone();
        dispatch!(simd => each(simd, &mut outputs, Real::exp));
        for (x, y) in inputs.iter().zip(&outputs) {
            let exact = f64::from(*x).exp();
            assert!((f64::from(*y) / exact - 1.0).abs() < 2e-7, "exp({x}) = {y}, not {exact}");
        }
    }
}
