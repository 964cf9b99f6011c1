//! Order statistics of few values. Values are finite and are reordered in place.

/// The value below which a share of the values lies (nearest rank); `None` for no values. Values
/// are finite; they are reordered.
pub fn quantile(values: &mut [f32], share: f32) -> Option<f32> {
    let last = values.len().checked_sub(1)?;
    let rank = (share.clamp(0.0, 1.0) * last as f32).round() as usize;
    Some(*values.select_nth_unstable_by(rank.min(last), f32::total_cmp).1)
}

/// The median of finite values, which are reordered; `None` for no values.
pub fn median(values: &mut [f32]) -> Option<f32> {
    quantile(values, 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_by_hand() {
        let mut values = [3.0, 1.0, 2.0, 5.0, 4.0];
        assert_eq!((quantile(&mut values, 0.0), quantile(&mut values, 1.0)), (Some(1.0), Some(5.0)));
        assert_eq!((median(&mut values), median(&mut [])), (Some(3.0), None));
    }
}
