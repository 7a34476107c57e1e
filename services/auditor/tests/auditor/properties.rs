//! What holds whatever happens.

use super::*;

proptest! {
    #[test]
    fn silhouettes_are_those_of_the_definition(
        robots in prop::collection::vec(((-3_i8..4, -3_i8..4), 0_usize..4), 2..14)
    ) {
        let names: Vec<String> = (0..robots.len()).map(|i| format!("r{i:02}")).collect();
        let points: Vec<[f64; 2]> =
            robots.iter().map(|((x, y), _)| [f64::from(*x), f64::from(*y)]).collect();
        let rows: Vec<(&str, [f64; 2])> =
            names.iter().map(String::as_str).zip(points.iter().copied()).collect();
        let members: Vec<(String, String)> = (0..4)
            .map(|team| {
                let own = names.iter().zip(&robots).filter(|(_, robot)| robot.1 == team);
                let own: Vec<&str> = own.map(|(name, _)| name.as_str()).collect();
                (format!("t{team}"), own.join(" "))
            })
            .filter(|(_, own)| !own.is_empty())
            .collect();
        let division: Vec<(&str, &str)> =
            members.iter().map(|(team, own)| (team.as_str(), own.as_str())).collect();
        let mut bench = Bench::leading(vec![]);
        bench.receive(embedding(1, &rows));
        bench.receive(teams(1, 1, &division, ""));
        let audit = bench.audit();
        if division.len() < 2 {
            prop_assert_eq!(audit.quality, Quality::Undefined);
        } else {
            let points: Vec<Vec<f64>> = points.iter().map(|point| point.to_vec()).collect();
            let labels: Vec<usize> = robots.iter().map(|robot| robot.1).collect();
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            check_report(&audit.in_embedding, &names, &points, &labels);
        }
    }
}
