#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace scenecalib {

/// One series of an x-y chart.
struct ChartSeries {
  std::string name;  ///< for the legend
  std::vector<Eigen::Vector2d> points;
  bool joined = true;  ///< by a line; otherwise dots alone
};

struct ChartAxes {
  std::string x_label;
  std::string y_label;
  bool logarithmic_y = false;  ///< values that are not positive are left out
  bool equal_scale = false;    ///< a metre is as long upwards as sideways
  bool from_zero = true;       ///< y starts at zero (linear only)
  bool logarithmic_x = false;  ///< values that are not positive are left out
};

/// An x-y chart as an <svg> element of 460 x 260 units that scales with its container. Points that
/// are not finite are left out; without any the chart says "no data".
std::string DrawChart(const std::vector<ChartSeries>& series, const ChartAxes& axes);

/// Bars side by side, one group per label: values[series][label]; NaN leaves a gap.
std::string DrawBars(const std::vector<std::string>& series_names,
                     const std::vector<std::string>& labels,
                     const std::vector<std::vector<double>>& values, const std::string& y_label);

/// A vector per cell of a grid over an image, drawn from the cell's middle.
struct FieldArrow {
  Eigen::Vector2d at_px = Eigen::Vector2d::Zero();      ///< in the image
  Eigen::Vector2d vector_px = Eigen::Vector2d::Zero();  ///< systematic part
  double spread_px = 0.0;                               ///< RMS in the cell: the cell's shade
};

/// Arrows over a frame of the image's shape, the longest as long as a cell, shaded by spread. Cells
/// that reach beyond the image are cut.
std::string DrawField(int width_px, int height_px, double cell_px,
                      const std::vector<FieldArrow>& arrows);

/// Text with the characters escaped that mean something in HTML and SVG.
std::string EscapeMarkup(const std::string& text);

}  // namespace scenecalib
