#include "report_residuals.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "scenecalib/evaluation/svg_chart.h"

namespace scenecalib {
namespace {

constexpr int kFieldColumns = 14;
constexpr int kMinSamples = 8;  // fewer residuals say nothing of a cell or bin

struct Bin {
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double square_sum = 0.0;
  int count = 0;

  void Add(const Eigen::Vector2d& residual_px) {
    sum += residual_px;
    square_sum += residual_px.squaredNorm();
    ++count;
  }
  double Rms() const { return std::sqrt(square_sum / count); }
};

std::string Field(const CameraConfig& camera, const std::vector<ResidualSample>& residuals) {
  if (!camera.model) return {};
  const double cell_px = static_cast<double>(camera.model->width_px()) / kFieldColumns;
  std::map<std::pair<int, int>, Bin> bins;
  for (const ResidualSample& sample : residuals) {
    bins[{static_cast<int>(sample.pixel.y() / cell_px),
          static_cast<int>(sample.pixel.x() / cell_px)}]
        .Add(sample.residual_px);
  }
  std::vector<FieldArrow> arrows;
  for (const auto& [cell, bin] : bins) {
    if (bin.count < kMinSamples) continue;
    arrows.push_back({cell_px * Eigen::Vector2d(cell.second + 0.5, cell.first + 0.5),
                      bin.sum / bin.count, bin.Rms()});
  }
  return DrawField(camera.model->width_px(), camera.model->height_px(), cell_px, arrows);
}

std::string ByRange(const ReportData& data) {
  // Each bin is about 1.5 times as far as the one before.
  constexpr double kRatio = 1.5;
  std::vector<ChartSeries> series;
  for (std::size_t c = 0; c < data.evidence.cameras.size(); ++c) {
    std::map<int, Bin> bins;
    for (const ResidualSample& sample : data.evidence.cameras[c].residuals) {
      if (!(sample.range_m > 0.0)) continue;
      bins[static_cast<int>(std::floor(std::log(sample.range_m) / std::log(kRatio)))].Add(
          sample.residual_px);
    }
    ChartSeries of_camera;
    of_camera.name = data.result.rig.cameras[c].name;
    for (const auto& [index, bin] : bins) {
      if (bin.count < kMinSamples) continue;
      of_camera.points.emplace_back(std::pow(kRatio, index + 0.5), bin.Rms());
    }
    series.push_back(std::move(of_camera));
  }
  return DrawChart(series, {"range, m", "residual RMS, px", false, false, true, true});
}

std::string BySurface(const ReportData& data) {
  std::vector<std::string> cameras;
  std::vector<std::vector<double>> values(2);
  for (std::size_t c = 0; c < data.evidence.cameras.size(); ++c) {
    cameras.push_back(data.result.rig.cameras[c].name);
    Bin bins[2];
    for (const ResidualSample& sample : data.evidence.cameras[c].residuals) {
      bins[sample.surface == SurfaceKind::kGround ? 0 : 1].Add(sample.residual_px);
    }
    for (std::size_t kind = 0; kind < 2; ++kind) {
      values[kind].push_back(bins[kind].count < kMinSamples
                                 ? std::numeric_limits<double>::quiet_NaN()
                                 : bins[kind].Rms());
    }
  }
  return DrawBars({"ground", "structure"}, cameras, values, "residual RMS, px");
}

}  // namespace

std::string FormatResiduals(const ReportData& data) {
  std::string html =
      "<h2>Residuals</h2><p>Of the tracks' transfers in the last solve. A good "
      "calibration leaves short arrows without a pattern.</p><div class=\"grid\">";
  for (std::size_t c = 0; c < data.evidence.cameras.size(); ++c) {
    const CameraConfig& camera = data.result.rig.cameras[c];
    html += "<figure>" + Field(camera, data.evidence.cameras[c].residuals) + "<figcaption>" +
            EscapeMarkup(camera.name) + ": by place in the image</figcaption></figure>";
  }
  html += "<figure>" + ByRange(data) + "<figcaption>by range</figcaption></figure>";
  html += "<figure>" + BySurface(data) + "<figcaption>by kind of surface</figcaption></figure>";
  return html + "</div>";
}

}  // namespace scenecalib
