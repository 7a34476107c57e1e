//! The results of experiments: pages to read, and every single number.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::Context as _;

/// One number of one run.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Which experiment.
    pub experiment: &'static str,
    /// What was divided.
    pub case: String,
    /// How many teams were asked for.
    pub teams: usize,
    /// What else was chosen: the radio, the noise.
    pub condition: String,
    /// By which method.
    pub method: String,
    /// Seed of the system and of all choices of the method.
    pub seed: u64,
    /// What is measured: `accuracy`, or robots that are `right` among those `counted`; `silhouette own`, `silhouette
    /// physical`, `silhouette common`, and `silhouette fused` in the vectors of the paper's method.
    pub measure: &'static str,
    /// The number.
    pub value: f64,
}

/// A page with its numbers.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Page {
    /// Markdown.
    pub text: String,
    /// In the order in which they were measured.
    pub records: Vec<Record>,
    /// Pictures that the text refers to, by the names of their files in [`PLOTS`], as SVG.
    pub plots: Vec<(String, String)>,
}

/// The folder of pictures next to the page.
pub const PLOTS: &str = "plots";

impl Page {
    /// Adds a heading and a paragraph.
    pub fn say(&mut self, heading: &str, paragraph: &str) {
        // Writing to a text does not fail.
        let _ = write!(self.text, "{heading}\n\n{paragraph}\n\n");
    }

    /// Adds a table.
    pub fn table(&mut self, head: &[String], rows: &[Vec<String>]) {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        self.text += &line(head);
        self.text += &line(&vec!["---".to_owned(); head.len()]);
        rows.iter().for_each(|row| self.text += &line(row));
        self.text.push('\n');
    }

    /// Adds a picture by the name of its file, without ending, with a description.
    pub fn plot(&mut self, name: &str, words: &str, svg: String) {
        let file = format!("{name}.svg");
        let _ = write!(self.text, "![{words}]({PLOTS}/{file})\n\n");
        self.plots.push((file, svg));
    }

    /// The values of the records that a question is about, by seed and in order.
    pub fn values<'a>(&'a self, is_asked: impl Fn(&Record) -> bool + 'a) -> Vec<f64> {
        self.records.iter().filter(|record| is_asked(record)).map(|record| record.value).collect()
    }

    /// Appends another page.
    pub fn append(&mut self, other: Self) {
        self.text += &other.text;
        self.records.extend(other.records);
        self.plots.extend(other.plots);
    }

    /// Writes RESULTS.md, results.csv and all pictures into a folder, which is made if need be.
    ///
    /// # Errors
    /// Names the file that cannot be written.
    pub fn write(&self, folder: &Path) -> anyhow::Result<()> {
        let named = |path: &Path| path.display().to_string();
        std::fs::create_dir_all(folder).with_context(|| named(folder))?;
        let file = folder.join("RESULTS.md");
        std::fs::write(&file, &self.text).with_context(|| named(&file))?;
        let file = folder.join("results.csv");
        let mut out = csv::Writer::from_path(&file).with_context(|| named(&file))?;
        let head =
            ["experiment", "case", "teams", "condition", "method", "seed", "measure", "value"];
        out.write_record(head)?;
        for record in &self.records {
            let (teams, seed) = (record.teams.to_string(), record.seed.to_string());
            let value = record.value.to_string();
            let Record { experiment, case, condition, method, measure, .. } = record;
            out.write_record([
                *experiment,
                case,
                &teams,
                condition,
                method,
                &seed,
                *measure,
                &value,
            ])?;
        }
        out.flush().with_context(|| named(&file))?;
        let plots = folder.join(PLOTS);
        if !self.plots.is_empty() {
            std::fs::create_dir_all(&plots).with_context(|| named(&plots))?;
        }
        for (name, svg) in &self.plots {
            let file = plots.join(name);
            std::fs::write(&file, svg).with_context(|| named(&file))?;
        }
        Ok(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_written_with_all_its_numbers() {
        let mut page = Page::default();
        page.say("# Title", "Words.");
        page.table(&["a".to_owned(), "b".to_owned()], &[vec!["1".to_owned(), "2".to_owned()]]);
        assert_eq!(page.text, "# Title\n\nWords.\n\n| a | b |\n| --- | --- |\n| 1 | 2 |\n\n");
        let record = Record {
            experiment: "formations",
            case: "squad, in line".to_owned(),
            teams: 2,
            condition: "net".to_owned(),
            method: "muster".to_owned(),
            seed: 7,
            measure: "accuracy",
            value: 0.5,
        };
        page.records.push(record);
        page.plot("noise", "Accuracy against noise", "<svg/>".to_owned());
        assert!(page.text.ends_with("![Accuracy against noise](plots/noise.svg)\n\n"));
        assert_eq!(page.values(|record| record.seed == 7), [0.5]);
        let folder = tempfile::tempdir().unwrap();
        page.write(&folder.path().join("new")).unwrap();
        let csv = std::fs::read_to_string(folder.path().join("new/results.csv")).unwrap();
        let line = "formations,\"squad, in line\",2,net,muster,7,accuracy,0.5\n";
        assert!(csv.ends_with(line), "{csv}");
        let svg = std::fs::read_to_string(folder.path().join("new/plots/noise.svg")).unwrap();
        assert_eq!(svg, "<svg/>");
    }
}
