//! A picture among the lines of a terminal, where it can show one: Kitty's graphics protocol, or iTerm2's inline images.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

/// Lines of text that a picture is high.
const ROWS: u32 = 16;
/// Most characters of one escape code of Kitty's protocol.
const MOST_CHUNK: usize = 4096;

/// How a terminal is given pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PictureProtocol {
    /// <https://sw.kovidgoyal.net/kitty/graphics-protocol/>
    Kitty,
    /// <https://iterm2.com/documentation-images.html>
    Iterm,
}

impl PictureProtocol {
    /// That of the terminal that these variables of the environment tell of; `None` if it shows none, or a multiplexer lies between.
    pub fn of_terminal(variable: impl Fn(&str) -> Option<String>) -> Option<Self> {
        let is = |name: &str, values: &[&str]| {
            variable(name).is_some_and(|value| values.contains(&value.as_str()))
        };
        if variable("TMUX").is_some() || variable("STY").is_some() {
            return None;
        }
        if is("TERM", &["xterm-kitty", "xterm-ghostty"]) || is("TERM_PROGRAM", &["ghostty"]) {
            return Some(Self::Kitty);
        }
        is("TERM_PROGRAM", &["iTerm.app", "WezTerm", "mintty", "rio"]).then_some(Self::Iterm)
    }

    /// What shows a PNG file, on lines of its own.
    pub fn shown(self, png: &[u8]) -> String {
        let text = STANDARD.encode(png);
        match self {
            Self::Iterm => {
                let size = png.len();
                format!(
                    "\x1b]1337;File=inline=1;size={size};height={ROWS};preserveAspectRatio=1:{text}\x07\n"
                )
            }
            Self::Kitty => {
                let chunks: Vec<&str> = text
                    .as_bytes()
                    .chunks(MOST_CHUNK)
                    .map(|chunk| std::str::from_utf8(chunk).unwrap_or_default())
                    .collect();
                let code = |(i, chunk): (usize, &&str)| {
                    let first = if i == 0 { format!("a=T,f=100,q=2,r={ROWS},") } else { String::new() };
                    let more = u8::from(i + 1 < chunks.len());
                    format!("\x1b_G{first}m={more};{chunk}\x1b\\")
                };
                chunks.iter().enumerate().map(code).collect::<String>() + "\n"
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(variables: &[(&str, &str)]) -> Option<PictureProtocol> {
        PictureProtocol::of_terminal(|name| {
            variables.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn terminals_are_told_by_their_variables() {
        assert_eq!(of(&[("TERM", "xterm-256color")]), None);
        assert_eq!(of(&[("TERM", "xterm-kitty")]), Some(PictureProtocol::Kitty));
        assert_eq!(of(&[("TERM_PROGRAM", "WezTerm")]), Some(PictureProtocol::Iterm));
        assert_eq!(of(&[("TERM", "xterm-kitty"), ("TMUX", "1")]), None);
    }

    #[test]
    fn pictures_come_back_from_their_codes() {
        let png: Vec<u8> = (0..10_000_u32).map(|i| (i * 7 + i / 256) as u8).collect();
        let kitty = PictureProtocol::Kitty.shown(&png);
        let codes: Vec<&str> = kitty.trim_end().split("\x1b_G").skip(1).collect();
        let parts: Vec<(&str, &str)> =
            codes.iter().map(|code| code.strip_suffix("\x1b\\").unwrap().split_once(';').unwrap()).collect();
        assert_eq!(parts[0].0, "a=T,f=100,q=2,r=16,m=1");
        assert_eq!(parts.iter().skip(1).map(|(keys, _)| *keys).collect::<Vec<_>>(), ["m=1", "m=1", "m=0"]);
        let text: String = parts.iter().map(|(_, text)| *text).collect();
        assert_eq!(STANDARD.decode(text).unwrap(), png);
        let iterm = PictureProtocol::Iterm.shown(&png);
        let text = iterm.trim_end().strip_suffix('\x07').unwrap().split_once("Ratio=1:").unwrap().1;
        assert!(iterm.contains("size=10000;") && STANDARD.decode(text).unwrap() == png);
    }
}
