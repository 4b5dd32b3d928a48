#include "scenecalib/evaluation/report_page.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <utility>

#include "report_residuals.h"
#include "scenecalib/evaluation/miscalibration_rate.h"
#include "scenecalib/evaluation/svg_chart.h"
#include "scenecalib/geometry/so3.h"

// Map of this file: one function per section of the page, in the page's order.

namespace scenecalib {
namespace {

constexpr double kDegreesPerRadian = 180.0 / 3.14159265358979323846;
constexpr double kLeastTurn_deg = 1e-4;  // smaller ones are drawn as this

const char* const kStyle = R"(<style>
body{font:15px/1.45 system-ui,"DejaVu Sans",sans-serif;color:#22262a;margin:0 auto;padding:24px;
max-width:1280px;background:#fff}
h1{font-size:26px;margin:0 0 4px}h2{font-size:19px;margin:34px 0 6px;border-bottom:1px solid #dde1e4;
padding-bottom:4px}p{margin:6px 0 10px;max-width:78em}
.verdict{padding:14px 18px;border-radius:6px;margin:14px 0;border-left:6px solid}
.good{background:#e9f5ee;border-color:#2f8f5b}.bad{background:#fbeeee;border-color:#b93434}
.verdict ul{margin:6px 0 0;padding-left:20px}
table{border-collapse:collapse;margin:8px 0 12px;font-variant-numeric:tabular-nums}
th,td{padding:4px 10px;text-align:right;border-bottom:1px solid #e4e6e8;white-space:nowrap}
th{background:#f4f5f6;font-weight:600}th:first-child,td:first-child{text-align:left}
.grid{display:grid;grid-template-columns:repeat(auto-fit,minmax(440px,1fr));gap:18px}
.pair{display:grid;grid-template-columns:1fr 1fr;gap:8px;margin:6px 0 16px}
figure{margin:0}figcaption{font-size:13px;color:#555;padding:2px 0}
svg{width:100%;height:auto;display:block;fill:#333}img{width:100%;display:block;border-radius:3px}
.wide{overflow-x:auto}.wide table{font-size:14px}.wide th{white-space:normal;vertical-align:bottom}small,.note{color:#666;font-size:13px}
@media(max-width:900px){.pair{grid-template-columns:1fr}}
</style>)";

template <typename... Args>
std::string Format(const char* format, Args... args) {
  char text[512];
  std::snprintf(text, sizeof(text), format, args...);
  return text;
}

/// A number for a table; infinity is what could not be evaluated.
std::string Number(double value, int digits) {
  return std::isfinite(value) ? Format("%.*f", digits, value) : std::string("&ndash;");
}

std::string Row(const char* tag, const std::vector<std::string>& cells) {
  std::string row = "<tr>";
  for (const std::string& cell : cells) row += Format("<%s>", tag) + cell + Format("</%s>", tag);
  return row + "</tr>";
}

/// Cells are markup already.
std::string Table(const std::vector<std::vector<std::string>>& rows) {
  std::string table = "<div class=\"wide\"><table>";
  for (std::size_t i = 0; i < rows.size(); ++i) table += Row(i == 0 ? "th" : "td", rows[i]);
  return table + "</table></div>";
}

std::string Figure(const std::string& content, const std::string& caption) {
  return "<figure>" + content + "<figcaption>" + EscapeMarkup(caption) + "</figcaption></figure>";
}

std::string Verdict(const ReportData& data) {
  const CalibrationResult& result = data.result;
  int num_accepted = 0;
  for (const CameraQuality& camera : result.cameras) num_accepted += camera.accepted ? 1 : 0;
  std::string html = Format("<div class=\"verdict %s\"><strong>%s</strong> %d of %zu cameras.<ul>",
                            result.accepted ? "good" : "bad",
                            result.accepted ? "Accepted:" : "Not accepted in full: accepted",
                            num_accepted, result.cameras.size());
  for (std::size_t i = 0; i < result.cameras.size(); ++i) {
    const CameraQuality& quality = result.cameras[i];
    html += "<li><strong>" + EscapeMarkup(result.rig.cameras[i].name) + "</strong>: " +
            (quality.accepted ? Format("accepted, residual %.3f &rarr; %.3f px",
                                       quality.rms_before_px, quality.rms_after_px)
                              : std::string("not accepted, keeps the values it had"));
    for (const std::string& reason : quality.reasons) html += "; " + EscapeMarkup(reason);
    html += "</li>";
  }
  return html + "</ul></div>";
}

/// Before, after, change and standard deviation of one camera's parameters.
std::string ParameterTable(const CameraConfig& before, const CameraConfig& after,
                           const CameraQuality& quality) {
  static const char* const kShifts[] = {"right, cm", "down, cm", "forward, cm"};
  static const char* const kTurns[] = {"pitch, deg", "yaw, deg", "roll, deg"};
  std::vector<std::vector<std::string>> rows = {
      {EscapeMarkup(after.name), "before", "after", "change", "std. dev."}};
  const auto deviation = [&quality](double value, int digits) {
    return quality.accepted ? "&plusmn; " + Number(value, digits) : std::string("&ndash;");
  };
  static const char* const kAxes[] = {"x", "y", "z"};
  for (int k = 0; k < 3; ++k) {
    const double from = before.lidar_from_camera.translation[k];
    const double to = after.lidar_from_camera.translation[k];
    rows.push_back({Format("position in the lidar frame %s, m", kAxes[k]), Number(from, 4),
                    Number(to, 4), Number(to - from, 4), ""});
  }
  const Rigid3 change = before.lidar_from_camera.Inverse() * after.lidar_from_camera;
  const Eigen::Vector3d turn_deg = kDegreesPerRadian * LogSo3(change.rotation);
  for (int k = 0; k < 3; ++k) {
    rows.push_back({Format("shift %s", kShifts[k]), "", "", Number(100 * change.translation[k], 2),
                    deviation(100 * quality.stddev.translation_m[k], 2)});
  }
  for (int k = 0; k < 3; ++k) {
    rows.push_back({Format("turn %s", kTurns[k]), "", "", Number(turn_deg[k], 3),
                    deviation(kDegreesPerRadian * quality.stddev.rotation_rad[k], 3)});
  }
  if (before.model && after.model) {
    const auto focal = [](const CameraModel& model) {
      ProjectionJacobians jacobians;
      const auto center = model.ProjectTuned(Eigen::Vector3d::UnitZ(), model.tunable(), &jacobians);
      return center ? jacobians.pixel_by_point(0, 0) : 0.0;
    };
    rows.push_back({"focal length, px", Number(focal(*before.model), 2),
                    Number(focal(*after.model), 2),
                    Number(focal(*after.model) - focal(*before.model), 2),
                    deviation(quality.stddev.focal_scale * focal(*after.model), 2)});
    for (int k = 0; k < 2; ++k) {
      const double from = before.model->tunable().principal_point_px[k];
      const double to = after.model->tunable().principal_point_px[k];
      rows.push_back({Format("principal point %s, px", kAxes[k]), Number(from, 2), Number(to, 2),
                      Number(to - from, 2), deviation(quality.stddev.principal_point_px[k], 2)});
    }
  }
  rows.push_back({"time offset, ms", Number(1e3 * before.time_offset_s, 2),
                  Number(1e3 * after.time_offset_s, 2),
                  Number(1e3 * (after.time_offset_s - before.time_offset_s), 2),
                  quality.stddev.time_offset_s > 0.0
                      ? deviation(1e3 * quality.stddev.time_offset_s, 2)
                      : std::string("held")});
  rows.push_back({"residual RMS, px", Number(quality.rms_before_px, 3),
                  Number(quality.rms_after_px, 3),
                  Number(quality.rms_after_px - quality.rms_before_px, 3), ""});
  return Table(rows);
}

std::string Parameters(const ReportData& data) {
  std::string html =
      "<h2>Result, before and after</h2><p>Shifts and turns are in the camera's own "
      "axes: right, down, forward.</p><div class=\"grid\">";
  for (std::size_t i = 0; i < data.result.cameras.size(); ++i) {
    html +=
        ParameterTable(data.initial.cameras[i], data.result.rig.cameras[i], data.result.cameras[i]);
  }
  return html + "</div>";
}

std::string Picture(const std::vector<unsigned char>& jpeg, const std::string& caption) {
  return Figure("<img alt=\"" + EscapeMarkup(caption) + "\" src=\"data:image/jpeg;base64," +
                    EncodeBase64(jpeg) + "\">",
                caption);
}

std::string Pictures(const char* title, const char* text,
                     const std::vector<ReportPicture>& pictures) {
  if (pictures.empty()) return {};
  std::string html = Format("<h2>%s</h2><p>%s</p>", title, text);
  for (const ReportPicture& picture : pictures) {
    html += "<div class=\"pair\">" + Picture(picture.before_jpeg, picture.caption + ", before") +
            Picture(picture.after_jpeg, picture.caption + ", after") + "</div>";
  }
  return html;
}

std::string Convergence(const ReportData& data) {
  std::vector<ChartSeries> rms;
  std::vector<ChartSeries> turns;
  for (std::size_t c = 0; c < data.evidence.cameras.size(); ++c) {
    ChartSeries of_rms;
    of_rms.name = data.result.rig.cameras[c].name;
    ChartSeries of_turns = of_rms;
    const std::vector<RoundEvidence>& rounds = data.evidence.cameras[c].rounds;
    for (std::size_t i = 0; i < rounds.size(); ++i) {
      const double round = static_cast<double>(i + 1);
      of_rms.points.emplace_back(round, rounds[i].rms_px);
      of_turns.points.emplace_back(
          round, std::max(kLeastTurn_deg, kDegreesPerRadian * rounds[i].rotation_change_rad));
    }
    rms.push_back(std::move(of_rms));
    turns.push_back(std::move(of_turns));
  }
  const CalibrationEvidence& evidence = data.evidence;
  return "<h2>Convergence</h2><p>The loop of each camera, from coarse to fine gates; the joint "
         "solve over all cameras follows and " +
         std::string(evidence.joint_converged ? "converged" : "stopped at its last iteration") +
         Format(", correcting the lidar's trajectory by %.1f mm and %.4f&deg; (RMS).</p>",
                1e3 * evidence.correction_rms_m, kDegreesPerRadian * evidence.correction_rms_rad) +
         "<div class=\"grid\">" +
         Figure(DrawChart(rms, {"round", "inlier RMS, px", true, false, false}),
                "residual of the inliers after each round") +
         Figure(DrawChart(turns, {"round", "change of rotation, deg", true, false, false}),
                "how far each round still turned the camera") +
         "</div>";
}

std::vector<double> Values(const std::optional<MiscalibrationRate>& rate) {
  if (!rate) return std::vector<double>(6, std::numeric_limits<double>::quiet_NaN());
  return {rate->x, rate->y, rate->z, rate->roll, rate->pitch, rate->yaw};
}

std::string MiscalibrationRates(const ReportData& data) {
  std::string charts;
  for (std::size_t i = 0; i < data.result.cameras.size(); ++i) {
    const CameraQuality& quality = data.result.cameras[i];
    const CameraConfig& camera = data.result.rig.cameras[i];
    if (!camera.model ||
        (!quality.miscalibration_rate_before && !quality.miscalibration_rate_after))
      continue;
    const FieldOfView field_of_view = FieldOfViewOf(*camera.model);
    charts += Figure(
        DrawBars({"before", "after", "published, " + std::string(ToString(field_of_view))},
                 {"x", "y", "z", "roll", "pitch", "yaw"},
                 {Values(quality.miscalibration_rate_before),
                  Values(quality.miscalibration_rate_after), Values(PublishedRate(field_of_view))},
                 "miscalibration rate"),
        camera.name);
  }
  if (charts.empty()) return {};
  return "<h2>Miscalibration rate</h2><p>Share of poses, up to 2 cm or 0.2&deg; off on one axis, "
         "under which two images look more alike than under the calibration: 0 is ideal, 0.5 is "
         "what a pose well off gives. Beside it what the paper states for its own recordings "
         "(Table I) of cameras with a similar field of view; recordings differ, so it is an "
         "orientation and not a limit.</p><div class=\"grid\">" +
         charts + "</div>";
}

std::string Tracks(const ReportData& data) {
  std::vector<std::vector<std::string>> rows = {{"camera", "tracks", "in the last solve"}};
  for (int k = 0; k < kNumAssociationOutcomes; ++k) {
    rows[0].push_back(EscapeMarkup(ToString(static_cast<AssociationOutcome>(k))));
  }
  for (const char* const name : {"inliers", "held out", "held-out px before", "after"}) {
    rows[0].emplace_back(name);
  }
  for (std::size_t c = 0; c < data.evidence.cameras.size(); ++c) {
    const CameraEvidence& evidence = data.evidence.cameras[c];
    const CameraQuality& quality = data.result.cameras[c];
    int total = 0;
    for (const int count : evidence.num_tracks_by_outcome) total += count;
    std::vector<std::string> row = {EscapeMarkup(data.result.rig.cameras[c].name),
                                    std::to_string(quality.num_tracks), std::to_string(total)};
    for (const int count : evidence.num_tracks_by_outcome) row.push_back(std::to_string(count));
    row.push_back(std::to_string(quality.num_inlier_tracks));
    row.push_back(std::to_string(evidence.num_held_out_tracks));
    row.push_back(Number(evidence.held_out_before_px, 3));
    row.push_back(Number(evidence.held_out_after_px, 3));
    rows.push_back(std::move(row));
  }
  return "<h2>Tracks and surfaces</h2><p>Tracks of image features, and whether they could be tied "
         "to a surface of the lidar's map; held-out tracks only judge the result.</p>" +
         Table(rows);
}

std::string CameraToCamera(const ReportData& data) {
  if (data.result.rig.cameras.size() < 2) return {};
  const CrossCameraMatching& matching = data.evidence.cross_camera;
  std::string html =
      "<h2>Camera to camera</h2><p>Points of one camera found in the images of another, at "
      "whatever "
      "time it saw them: distance between where they are seen and where map and calibration put "
      "them." +
      Format(
          " Of %d candidates, %d were hidden, %d lay off the surface, %d looked different, %d "
          "were ambiguous and %d did not register.</p>",
          matching.num_candidates, matching.num_occluded, matching.num_off_plane,
          matching.num_unlike, matching.num_wide, matching.num_unregistered);
  if (data.evidence.pairs.empty()) {
    return html + "<p>No matches: the cameras are tied together by the lidar alone.</p>";
  }
  std::vector<std::vector<std::string>> rows = {
      {"points of", "seen by", "matches", "median before, px", "after, px"}};
  for (const CrossCameraEvidence& pair : data.evidence.pairs) {
    const auto name = [&data](int camera) {
      return EscapeMarkup(data.result.rig.cameras[static_cast<std::size_t>(camera)].name);
    };
    rows.push_back({name(pair.source_camera), name(pair.target_camera),
                    std::to_string(pair.num_matches), Number(pair.median_before_px, 2),
                    Number(pair.median_after_px, 3)});
  }
  return html + Table(rows);
}

std::string Drive(const ReportData& data) {
  ChartSeries path{"lidar", {}, true};
  ChartSeries height{"height", {}, true};
  constexpr std::size_t kMaxPoints = 600;
  const std::vector<TimedPose>& poses = data.map_from_lidar.poses();
  const std::size_t stride = poses.size() / kMaxPoints + 1;
  for (std::size_t i = 0; i < poses.size(); i += stride) {
    const Eigen::Vector3d& at = poses[i].map_from_lidar.translation;
    path.points.emplace_back(at.x(), at.y());
    height.points.emplace_back(SecondsBetween(poses[0].stamp_ns, poses[i].stamp_ns), at.z());
  }
  std::string html = "<h2>Drive and map</h2>";
  for (const std::string& fact : data.facts) html += "<p>" + EscapeMarkup(fact) + "</p>";
  return html + "<div class=\"grid\">" +
         Figure(DrawChart({path}, {"x, m", "y, m", false, true, false}),
                "the lidar's path from above") +
         Figure(DrawChart({height}, {"time, s", "height, m", false, false, false}),
                "the lidar's height") +
         "</div>";
}

std::string Costs(const ReportData& data) {
  std::vector<std::vector<std::string>> rows = {{"stage", "wall, s", "peak memory, MiB"}};
  double total_s = 0.0;
  double peak_mib = 0.0;
  for (const ReportStage& stage : data.stages) {
    rows.push_back(
        {EscapeMarkup(stage.stage), Number(stage.wall_s, 1), Number(stage.peak_memory_mib, 0)});
    total_s += stage.wall_s;
    peak_mib = std::max(peak_mib, stage.peak_memory_mib);
  }
  rows.push_back({"all", Number(total_s, 1), Number(peak_mib, 0)});
  std::string html = "<h2>Run time and memory</h2>" + Table(rows);
  if (data.warnings.empty()) return html + "<p class=\"note\">No warnings.</p>";
  html += "<h2>Warnings</h2><ul>";
  for (const std::string& warning : data.warnings) html += "<li>" + EscapeMarkup(warning) + "</li>";
  return html + "</ul>";
}

}  // namespace

std::string EncodeBase64(const std::vector<unsigned char>& bytes) {
  static const char* const kDigits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const unsigned a = bytes[i];
    const unsigned b = i + 1 < bytes.size() ? bytes[i + 1] : 0;
    const unsigned c = i + 2 < bytes.size() ? bytes[i + 2] : 0;
    text += kDigits[a >> 2];
    text += kDigits[(a & 3) << 4 | b >> 4];
    text += i + 1 < bytes.size() ? kDigits[(b & 15) << 2 | c >> 6] : '=';
    text += i + 2 < bytes.size() ? kDigits[c & 63] : '=';
  }
  return text;
}

std::string FormatReportPage(const ReportData& data) {
  return std::string(
             "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">"
             "<meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">"
             "<link rel=\"icon\" href=\"data:,\"><title>scenecalib report</title>") +
         kStyle + "</head><body>\n<h1>Calibration report</h1>\n" + Verdict(data) + "\n" +
         Parameters(data) + "\n" +
         Pictures("Lidar over image",
                  "The map's points, coloured by range: edges must lie on edges, near and far.",
                  data.overlays) +
         "\n" +
         Pictures("Images over cloud",
                  "The lidar's points with the colours that the cameras give them: edges must not "
                  "be smeared onto what lies behind.",
                  data.clouds) +
         "\n" + FormatResiduals(data) + "\n" + Convergence(data) + "\n" +
         MiscalibrationRates(data) + "\n" + Tracks(data) + "\n" + CameraToCamera(data) + "\n" +
         Drive(data) + "\n" + Costs(data) + "\n</body></html>\n";
}

}  // namespace scenecalib
