//! Markdown pages of the project: code blocks, links, headings.

use std::path::{Path, PathBuf};

/// The root of the repository.
pub fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A page, with its path from the root of the repository.
pub struct Page {
    pub path: PathBuf,
    pub text: String,
}

/// README, CHANGELOG, CONTRIBUTING and everything in `docs/`.
pub fn pages() -> Vec<Page> {
    let mut paths: Vec<PathBuf> =
        ["README.md", "CHANGELOG.md", "CONTRIBUTING.md"].map(PathBuf::from).to_vec();
    add_pages(Path::new("docs"), &mut paths);
    let read = |path: PathBuf| {
        let text = std::fs::read_to_string(repository().join(&path));
        Page { text: text.unwrap_or_else(|error| panic!("{}: {error}", path.display())), path }
    };
    paths.into_iter().map(read).collect()
}

fn add_pages(folder: &Path, paths: &mut Vec<PathBuf>) {
    for name in names(folder) {
        let path = folder.join(name);
        if repository().join(&path).is_dir() {
            // What `mdbook build` writes is no source.
            if path != Path::new("docs/book") {
                add_pages(&path, paths);
            }
        } else if path.extension().is_some_and(|extension| extension == "md") {
            paths.push(path);
        }
    }
}

/// The names of what is in a folder, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(repository().join(folder)).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// A fenced code block.
pub struct Block {
    /// What stands behind the fence, up to a comma.
    pub language: String,
    pub text: String,
    /// The line of the fence, from 1.
    pub line: usize,
}

impl Page {
    /// The fenced code blocks.
    pub fn blocks(&self) -> Vec<Block> {
        let (mut blocks, mut open): (Vec<Block>, Option<Block>) = (Vec::new(), None);
        for (i, line) in self.text.lines().enumerate() {
            match (line.trim_start().strip_prefix("```"), &mut open) {
                (Some(_), Some(_)) => blocks.extend(open.take()),
                (Some(language), None) => {
                    let language = language.split(',').next().unwrap_or_default().trim().to_owned();
                    open = Some(Block { language, text: String::new(), line: i + 1 });
                }
                (None, Some(block)) => block.text += &format!("{line}\n"),
                (None, None) => {}
            }
        }
        assert!(open.is_none(), "{}: a code block is not closed", self.path.display());
        blocks
    }

    /// The text without code blocks, line by line.
    fn prose(&self) -> impl Iterator<Item = &str> {
        let mut inside = false;
        self.text.lines().filter(move |line| {
            let fence = line.trim_start().starts_with("```");
            inside ^= fence;
            !inside && !fence
        })
    }

    /// What its links and pictures point at.
    pub fn targets(&self) -> Vec<String> {
        let mut targets = Vec::new();
        for line in self.prose() {
            let line = without_code(line);
            for (before, after) in [("](", ')'), ("src=\"", '"'), ("href=\"", '"'), ("srcset=\"", '"')] {
                for rest in line.split(before).skip(1) {
                    targets.push(rest[..rest.find(after).unwrap_or(rest.len())].to_owned());
                }
            }
        }
        targets
    }

    /// The anchors of its headings.
    pub fn anchors(&self) -> Vec<String> {
        let mut anchors: Vec<String> = Vec::new();
        for line in self.prose().filter(|line| line.starts_with('#')) {
            let own = anchor(line.trim_start_matches('#').trim());
            let again = (1..).map(|n| format!("{own}-{n}"));
            let free = std::iter::once(own.clone()).chain(again).find(|a| !anchors.contains(a));
            anchors.extend(free);
        }
        anchors
    }
}

/// A line with inline code blanked.
fn without_code(line: &str) -> String {
    line.split('`')
        .enumerate()
        .filter(|(i, _)| i % 2 == 0)
        .map(|(_, part)| part)
        .collect::<Vec<_>>()
        .join("`")
}

/// The anchor that forges and mdBook give a heading.
pub fn anchor(heading: &str) -> String {
    let kept = heading.to_lowercase();
    let kept = kept.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

#[test]
fn markdown_is_read() {
    let text = "# A `b`: c\n[x](y.md#z) `[no](code)`\n```sh,no_run\n[no](block)\n```\n# A b c\n![p](i.png)\n";
    let page = Page { path: "p.md".into(), text: text.to_owned() };
    assert_eq!(page.targets(), ["y.md#z", "i.png"]);
    assert_eq!(page.anchors(), ["a-b-c", "a-b-c-1"]);
    let blocks = page.blocks();
    assert_eq!((blocks[0].language.as_str(), blocks[0].line), ("sh", 3));
}
