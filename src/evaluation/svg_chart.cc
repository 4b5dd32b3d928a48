#include "scenecalib/evaluation/svg_chart.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

namespace scenecalib {
namespace {

constexpr double kWidth = 460.0;
constexpr double kHeight = 260.0;
constexpr double kLeft = 58.0;
constexpr double kRight = 12.0;
constexpr double kTop = 26.0;
constexpr double kBottom = 42.0;

const char* const kColours[] = {"#8c9196", "#1668b3", "#d9772b", "#2f8f5b",
                                "#8457b2", "#c2405c", "#3a9fa3", "#7a6a3a"};

const char* Colour(std::size_t index) { return kColours[index % 8]; }

template <typename... Args>
std::string Format(const char* format, Args... args) {
  char text[512];
  std::snprintf(text, sizeof(text), format, args...);
  return text;
}

/// "0.1", "20", "1e-05": as short as a label can be.
std::string Label(double value) { return Format("%.4g", std::abs(value) < 1e-12 ? 0.0 : value); }

std::string Text(double x, double y, const char* anchor, const std::string& text,
                 const char* more = "") {
  return Format("<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\"%s>", x, y, anchor, more) +
         EscapeMarkup(text) + "</text>";
}

std::string Line(double x1, double y1, double x2, double y2, const char* colour) {
  return Format("<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" stroke=\"%s\"/>", x1, y1, x2,
                y2, colour);
}

std::string Open(double width, double height) {
  return Format("<svg viewBox=\"0 0 %.0f %.0f\" role=\"img\" font-size=\"11\">", width, height);
}

std::string Legend(const std::vector<std::string>& names) {
  std::string svg;
  double x = kLeft;
  for (std::size_t i = 0; i < names.size(); ++i) {
    svg +=
        Format("<rect x=\"%.1f\" y=\"8\" width=\"10\" height=\"10\" fill=\"%s\"/>", x, Colour(i));
    svg += Text(x + 14.0, 17.0, "start", names[i]);
    x += 24.0 + 6.2 * static_cast<double>(names[i].size());
  }
  return svg;
}

/// Distance of ticks, 1, 2 or 5 times a power of ten, about `count` of them.
double TickStep(double span, int count) {
  const double raw = span / count;
  const double power = std::pow(10.0, std::floor(std::log10(raw)));
  for (const double factor : {1.0, 2.0, 5.0}) {
    if (raw <= factor * power) return factor * power;
  }
  return 10.0 * power;
}

/// Values along one axis of a chart and where they are drawn.
struct Scale {
  double low = 0.0;
  double high = 1.0;
  double at_low = 0.0;
  double at_high = 1.0;
  bool logarithmic = false;

  double At(double value) const {
    const double t =
        logarithmic ? std::log(value / low) / std::log(high / low) : (value - low) / (high - low);
    return at_low + t * (at_high - at_low);
  }

  std::vector<double> Ticks() const {
    std::vector<double> ticks;
    if (logarithmic) {
      const bool decades_only = high > 300.0 * low;
      for (double tick = std::pow(10.0, std::floor(std::log10(low))); tick <= high * 1.001;
           tick *= 10.0) {
        for (const double factor : {1.0, 2.0, 5.0}) {
          if (decades_only && factor > 1.0) continue;
          if (factor * tick >= low * 0.999 && factor * tick <= high * 1.001) {
            ticks.push_back(factor * tick);
          }
        }
      }
      return ticks;
    }
    const double step = TickStep(high - low, 5);
    for (double tick = std::ceil(low / step - 1e-9) * step; tick <= high + 1e-9 * step;
         tick += step) {
      ticks.push_back(tick);
    }
    return ticks;
  }
};

bool Drawable(const Eigen::Vector2d& point, const ChartAxes& axes) {
  return point.allFinite() && (!axes.logarithmic_y || point.y() > 0.0) &&
         (!axes.logarithmic_x || point.x() > 0.0);
}

/// False without any point.
bool FitScales(const std::vector<ChartSeries>& series, const ChartAxes& axes, Scale* x, Scale* y) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  Eigen::Vector2d low(kInfinity, kInfinity);
  Eigen::Vector2d high = -low;
  for (const ChartSeries& one : series) {
    for (const Eigen::Vector2d& point : one.points) {
      if (!Drawable(point, axes)) continue;
      low = low.cwiseMin(point);
      high = high.cwiseMax(point);
    }
  }
  if (!(low.x() <= high.x())) return false;
  if (axes.logarithmic_y) {
    low.y() *= 0.8;
    high.y() *= 1.25;
  } else if (axes.from_zero) {
    low.y() = std::min(low.y(), 0.0);
    high.y() += 0.08 * (high.y() - low.y());
  }
  if (axes.logarithmic_x) {
    low.x() *= 0.95;
    high.x() *= 1.05;
  }
  for (int k = 0; k < 2; ++k) {
    if (high[k] - low[k] > 1e-12) continue;
    const double room = std::max(0.5, 0.1 * std::abs(high[k]));
    high[k] += room;
    if (!(k == 1 && (axes.logarithmic_y || axes.from_zero))) low[k] -= room;
  }
  const Eigen::Array2d size(kWidth - kLeft - kRight, kHeight - kTop - kBottom);
  if (axes.equal_scale) {
    const double units = ((high - low).array() / size).maxCoeff();
    const Eigen::Vector2d grow = 0.5 * (units * size - (high - low).array()).matrix();
    low -= grow;
    high += grow;
  }
  *x = {low.x(), high.x(), kLeft, kWidth - kRight, axes.logarithmic_x};
  *y = {low.y(), high.y(), kHeight - kBottom, kTop, axes.logarithmic_y};
  return true;
}

std::string DrawAxes(const Scale& x, const Scale& y, const ChartAxes& axes) {
  std::string svg;
  for (const double tick : y.Ticks()) {
    svg += Line(kLeft, y.At(tick), kWidth - kRight, y.At(tick), "#e4e6e8");
    svg += Text(kLeft - 6.0, y.At(tick) + 4.0, "end", Label(tick));
  }
  for (const double tick : x.Ticks()) {
    svg += Line(x.At(tick), kHeight - kBottom, x.At(tick), kHeight - kBottom + 4.0, "#555");
    svg += Text(x.At(tick), kHeight - kBottom + 16.0, "middle", Label(tick));
  }
  svg += Line(kLeft, kHeight - kBottom, kWidth - kRight, kHeight - kBottom, "#555");
  svg += Text(0.5 * (kLeft + kWidth - kRight), kHeight - 6.0, "middle", axes.x_label);
  svg +=
      Text(14.0, 0.5 * (kTop + kHeight - kBottom), "middle", axes.y_label,
           Format(" transform=\"rotate(-90 14 %.1f)\"", 0.5 * (kTop + kHeight - kBottom)).c_str());
  return svg;
}

std::string NoData() {
  return Open(kWidth, kHeight) + Text(0.5 * kWidth, 0.5 * kHeight, "middle", "no data") + "</svg>";
}

}  // namespace

std::string EscapeMarkup(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    switch (c) {
      case '&':
        escaped += "&amp;";
        break;
      case '<':
        escaped += "&lt;";
        break;
      case '>':
        escaped += "&gt;";
        break;
      case '"':
        escaped += "&quot;";
        break;
      default:
        escaped += c;
    }
  }
  return escaped;
}

std::string DrawChart(const std::vector<ChartSeries>& series, const ChartAxes& axes) {
  Scale x;
  Scale y;
  if (!FitScales(series, axes, &x, &y)) return NoData();
  std::string svg = Open(kWidth, kHeight) + DrawAxes(x, y, axes);
  std::vector<std::string> names;
  for (std::size_t i = 0; i < series.size(); ++i) {
    names.push_back(series[i].name);
    std::string path;
    for (const Eigen::Vector2d& point : series[i].points) {
      if (!Drawable(point, axes)) continue;
      path += Format(" %.1f,%.1f", x.At(point.x()), y.At(point.y()));
      if (series[i].joined && series[i].points.size() > 40) continue;
      svg += Format("<circle cx=\"%.1f\" cy=\"%.1f\" r=\"2.6\" fill=\"%s\"/>", x.At(point.x()),
                    y.At(point.y()), Colour(i));
    }
    if (!series[i].joined) continue;
    svg +=
        Format("<polyline fill=\"none\" stroke=\"%s\" stroke-width=\"1.6\" points=\"", Colour(i)) +
        path + "\"/>";
  }
  if (names.size() > 1) svg += Legend(names);
  return svg + "</svg>";
}

std::string DrawBars(const std::vector<std::string>& series_names,
                     const std::vector<std::string>& labels,
                     const std::vector<std::vector<double>>& values, const std::string& y_label) {
  double high = 0.0;
  for (const std::vector<double>& series : values) {
    for (const double value : series) {
      if (std::isfinite(value)) high = std::max(high, value);
    }
  }
  if (labels.empty() || values.empty()) return NoData();
  const Scale y{0.0, high > 0.0 ? 1.08 * high : 1.0, kHeight - kBottom, kTop, false};
  const Scale x{0.0, static_cast<double>(labels.size()), kLeft, kWidth - kRight, false};
  std::string svg = Open(kWidth, kHeight);
  for (const double tick : y.Ticks()) {
    svg += Line(kLeft, y.At(tick), kWidth - kRight, y.At(tick), "#e4e6e8");
    svg += Text(kLeft - 6.0, y.At(tick) + 4.0, "end", Label(tick));
  }
  const double bar = 0.8 / static_cast<double>(values.size());
  for (std::size_t label = 0; label < labels.size(); ++label) {
    const double group = static_cast<double>(label) + 0.1;
    for (std::size_t i = 0; i < values.size(); ++i) {
      if (label >= values[i].size() || !std::isfinite(values[i][label])) continue;
      const double left = x.At(group + bar * static_cast<double>(i));
      const double top = y.At(values[i][label]);
      svg += Format("<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\" fill=\"%s\">", left,
                    top, x.At(bar) - x.At(0.0) - 1.0, kHeight - kBottom - top, Colour(i)) +
             "<title>" + EscapeMarkup(series_names[i]) + " " + Label(values[i][label]) +
             "</title></rect>";
    }
    svg += Text(x.At(static_cast<double>(label) + 0.5), kHeight - kBottom + 16.0, "middle",
                labels[label]);
  }
  svg += Line(kLeft, kHeight - kBottom, kWidth - kRight, kHeight - kBottom, "#555");
  svg +=
      Text(14.0, 0.5 * (kTop + kHeight - kBottom), "middle", y_label,
           Format(" transform=\"rotate(-90 14 %.1f)\"", 0.5 * (kTop + kHeight - kBottom)).c_str());
  return svg + Legend(series_names) + "</svg>";
}

std::string DrawField(int width_px, int height_px, double cell_px,
                      const std::vector<FieldArrow>& arrows) {
  const double scale = kWidth / width_px;
  const double height = scale * height_px;
  double longest = 0.0;
  double widest = 0.0;
  for (const FieldArrow& arrow : arrows) {
    longest = std::max(longest, arrow.vector_px.norm());
    widest = std::max(widest, arrow.spread_px);
  }
  std::string svg = Open(kWidth, height + 22.0);
  svg += Format(
      "<rect x=\"0.5\" y=\"0.5\" width=\"%.1f\" height=\"%.1f\" fill=\"#f7f8f9\" "
      "stroke=\"#bbb\"/>",
      kWidth - 1.0, height - 1.0);
  if (arrows.empty()) {
    return svg + Text(0.5 * kWidth, 0.5 * height, "middle", "no data") + "</svg>";
  }
  const double edge = scale * cell_px;
  for (const FieldArrow& arrow : arrows) {
    const Eigen::Vector2d at = scale * arrow.at_px;
    const double shade = widest > 0.0 ? 0.55 * arrow.spread_px / widest : 0.0;
    const Eigen::Vector2d frame(kWidth, height);
    const Eigen::Vector2d low = (at.array() - 0.5 * edge).max(0.0);
    const Eigen::Vector2d high = (at.array() + 0.5 * edge - 0.6).min(frame.array());
    svg += Format(
        "<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\" fill=\"#d9772b\" "
        "fill-opacity=\"%.2f\"/>",
        low.x(), low.y(), high.x() - low.x(), high.y() - low.y(), shade);
  }
  for (const FieldArrow& arrow : arrows) {
    if (!(longest > 0.0)) break;
    const Eigen::Vector2d at = scale * arrow.at_px;
    const Eigen::Vector2d tip = at + 0.9 * edge / longest * arrow.vector_px;
    svg += Line(at.x(), at.y(), tip.x(), tip.y(), "#10395f");
    svg += Format("<circle cx=\"%.1f\" cy=\"%.1f\" r=\"1.5\" fill=\"#10395f\"/>", at.x(), at.y());
  }
  svg += Text(
      0.0, height + 16.0, "start",
      Format("longest arrow %.3f px (mean of a cell), darkest cell %.3f px RMS", longest, widest));
  return svg + "</svg>";
}

}  // namespace scenecalib
