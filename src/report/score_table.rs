//! Scores as tables for the terminal.

use crate::report::orb::OrbScores;
use crate::report::scores::{PassScores, Scaling, Scores};
use crate::report::srgb::SrgbScores;
use std::fmt::Write;

/// Head of the table of sRGB scores.
const SRGB_HEAD: [&str; 6] = ["in sRGB", "mask dB", "white dB", "SSIM", "black dB", "SSIM"];

impl Scores {
    /// A table for the terminal, one line per pass; a second one of sRGB scores, if there are any; a line for each pass that is
    /// scored as Stanford-ORB does; and a line for the rest. Ends with a
    /// line break.
    pub fn table(&self) -> String {
        let mut rows = vec![["pass", "PSNR dB", "raw", "SSIM", "scale R", "G", "B"].map(str::to_owned)];
        for (name, pass) in &self.passes {
            rows.extend(pass_rows(name, pass));
        }
        let mut text = if self.passes.is_empty() { String::new() } else { aligned(&rows) };
        text.push_str(&self.srgb_table());
        for (name, pass) in &self.passes {
            if let Some(OrbScores { psnr_hdr, psnr_ldr }) = pass.stanford_orb {
                let _ = writeln!(
                    text,
                    "{name}, as Stanford-ORB: PSNR-H {psnr_hdr:.2} dB, PSNR-L {psnr_ldr:.2} dB"
                );
            }
        }
        let rest: Vec<String> = [
            self.albedo_psnr.map(|v| format!("albedo {v:.2} dB")),
            self.normals(),
            self.mask_iou.map(|v| format!("mask IoU {v:.4}")),
            self.chamfer.map(|v| format!("Chamfer {v:.5}")),
            self.fit_secs.map(|v| format!("fit {v:.1} s")),
            self.peak_rss_mib.map(|v| format!("peak memory {v:.0} MiB")),
        ]
        .into_iter()
        .flatten()
        .collect();
        if !rest.is_empty() {
            let _ = writeln!(text, "{}", rest.join(" · "));
        }
        text
    }

    /// The table of sRGB scores below a blank line; empty if there are none.
    fn srgb_table(&self) -> String {
        let scored = self.passes.iter().filter_map(|(name, pass)| Some(srgb_row(name, &pass.srgb?)));
        let rows: Vec<_> = std::iter::once(SRGB_HEAD.map(str::to_owned)).chain(scored).collect();
        if rows.len() > 1 { format!("\n{}", aligned(&rows)) } else { String::new() }
    }

    /// "normals 0.12° (median 0.08°, 12779 pixels)".
    fn normals(&self) -> Option<String> {
        let mean = self.normal_deg?;
        let more = self.normal_median_deg.zip(self.normal_pixels);
        let more = more.map(|(median, pixels)| format!(" (median {median:.2}°, {pixels} pixels)"));
        Some(format!("normals {mean:.2}°{}", more.unwrap_or_default()))
    }
}

fn srgb_row(name: &str, scores: &SrgbScores) -> [String; 6] {
    let (psnr, ssim) = (|value: f64| format!("{value:.2}"), |value: f64| format!("{value:.4}"));
    let SrgbScores { psnr_mask, psnr_white, psnr_black, ssim_white, ssim_black } = *scores;
    let [on_white, on_black] = [ssim(ssim_white), ssim(ssim_black)];
    [name.to_owned(), psnr(psnr_mask), psnr(psnr_white), on_white, psnr(psnr_black), on_black]
}

fn pass_rows(name: &str, pass: &PassScores) -> Vec<[String; 7]> {
    let [r, g, b] = match pass.scaling {
        Scaling::None => ["–", "–", "–"].map(str::to_owned),
        // Their mean.
        Scaling::PerView => pass.scale.map(|s| format!("ø {s:.3}")),
        _ => pass.scale.map(|s| format!("{s:.3}")),
    };
    let number = |value: f64| format!("{value:.2}");
    let mut rows = vec![[
        name.to_owned(),
        number(pass.psnr),
        number(pass.psnr_raw),
        format!("{:.4}", pass.ssim),
        r,
        g,
        b,
    ]];
    if let Some(specular) = pass.scale_specular {
        let [r, g, b] = specular.map(|s| format!("{s:.3}"));
        let blank = String::new;
        rows.push(["  its specular layer".to_owned(), blank(), blank(), blank(), r, g, b]);
    }
    rows
}

/// Pads columns to their widest entry, with a rule under the first row; the first column is left-aligned, the others right-aligned.
pub(super) fn aligned<const N: usize>(rows: &[[String; N]]) -> String {
    let width: [usize; N] =
        std::array::from_fn(|c| rows.iter().map(|row| row[c].chars().count()).max().unwrap_or(0));
    let mut text = String::new();
    for (i, row) in rows.iter().enumerate() {
        let mut line = String::new();
        for (c, entry) in row.iter().enumerate() {
            let _ = if c == 0 {
                write!(line, "{entry:<0$}", width[c])
            } else {
                write!(line, "  {entry:>0$}", width[c])
            };
        }
        let _ = writeln!(text, "{}", line.trim_end());
        if i == 0 {
            let _ = writeln!(text, "{}", "─".repeat(width.iter().sum::<usize>() + 2 * (N - 1)));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use indexmap::IndexMap;

    const TABLE: &str = "\
pass                  PSNR dB   raw    SSIM  scale R      G       B
───────────────────────────────────────────────────────────────────
novel                   41.62  9.50  0.9877        –      –       –
edited_gold             41.62  9.50  0.9877    1.000  0.500  12.250
  its specular layer                           2.000  2.000   2.000

in sRGB  mask dB  white dB    SSIM  black dB    SSIM
────────────────────────────────────────────────────
novel      28.12     31.50  0.9600      9.88  0.7500
normals 0.12° · peak memory 812 MiB
";

    fn pass(scaling: Scaling, specular: Option<[f64; 3]>, srgb: Option<SrgbScores>) -> PassScores {
        PassScores {
            psnr: 41.618,
            psnr_raw: 9.5,
            ssim: 0.98765,
            scaling,
            scale: [1.0, 0.5, 12.25],
            scale_specular: specular,
            srgb,
            stanford_orb: None,
            views: Vec::new(),
        }
    }

    #[test]
    fn the_table_lines_up() {
        let srgb = SrgbScores {
            psnr_mask: 28.125,
            psnr_white: 31.5,
            psnr_black: 9.876,
            ssim_white: 0.96,
            ssim_black: 0.75,
        };
        let passes = IndexMap::from([
            ("novel".to_owned(), pass(Scaling::None, None, Some(srgb))),
            ("edited_gold".to_owned(), pass(Scaling::PerLayer, Some([2.0; 3]), None)),
        ]);
        let mut scores =
            Scores { passes, normal_deg: Some(0.125), peak_rss_mib: Some(812.4), ..Scores::default() };
        assert_eq!(scores.table(), TABLE);
        (scores.normal_median_deg, scores.normal_pixels) = (Some(0.075), Some(12_779));
        assert!(
            scores.table().contains("normals 0.12° (median 0.07°, 12779 pixels) · "),
            "{}",
            scores.table()
        );
        scores.passes[0].stanford_orb = Some(OrbScores { psnr_hdr: 25.614, psnr_ldr: 31.2 });
        let line = "\nnovel, as Stanford-ORB: PSNR-H 25.61 dB, PSNR-L 31.20 dB\n";
        assert!(scores.table().contains(line), "{}", scores.table());
        assert_eq!(Scores::default().table(), "");
    }
}
