#include "scenecalib/evaluation/svg_chart.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>
#include <vector>

namespace scenecalib {
namespace {

int Count(const std::string& text, const std::string& part) {
  int count = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) {
    ++count;
  }
  return count;
}

TEST(SvgChart, DrawsAPointPerValueAndALinePerJoinedSeries) {
  const std::string svg =
      DrawChart({{"a", {{1.0, 2.0}, {2.0, 3.0}}, true}, {"b", {{1.0, 1.0}}, false}},
                {"x", "y", false, false});
  EXPECT_EQ(Count(svg, "<circle"), 3);
  EXPECT_EQ(Count(svg, "<polyline"), 1);
  EXPECT_EQ(svg.substr(0, 4), "<svg");
  EXPECT_EQ(svg.substr(svg.size() - 6), "</svg>");
}

TEST(SvgChart, LeavesOutWhatCannotBeDrawn) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const std::vector<Eigen::Vector2d> points = {
      {1.0, kInfinity}, {std::nan(""), 1.0}, {1.0, -1.0}, {2.0, 0.5}, {3.0, 5.0}};
  const std::string svg = DrawChart({{"a", points, false}}, {"x", "y", true, false});
  EXPECT_EQ(Count(svg, "<circle"), 2);  // neither infinite, nor NaN, nor negative on a log scale
  EXPECT_EQ(Count(svg, "nan"), 0);
  EXPECT_EQ(Count(svg, "inf"), 0);
}

TEST(SvgChart, ALogarithmicAxisPutsEqualRatiosAtEqualDistances) {
  ChartAxes axes{"x", "y"};
  axes.logarithmic_x = true;
  const std::string svg =
      DrawChart({{"a", {{0.0, 1.0}, {1.0, 1.0}, {10.0, 2.0}, {100.0, 3.0}}, false}}, axes);
  std::vector<double> at;
  for (std::size_t i = svg.find("cx=\""); i != std::string::npos; i = svg.find("cx=\"", i + 1)) {
    at.push_back(std::stod(svg.substr(i + 4)));
  }
  ASSERT_EQ(at.size(), 3u);                         // zero has no place
  EXPECT_NEAR(at[1] - at[0], at[2] - at[1], 0.11);  // written to a tenth
}

TEST(SvgChart, CellsOfAFieldStayWithinTheImage) {
  // The last row's middle is 2 px above the image's end, its half edge is 8.
  const std::string svg = DrawField(64, 42, 16.0, {{{8.0, 40.0}, {0.1, 0.0}, 1.0}});
  const std::string cell = svg.substr(svg.find("fill-opacity") - 90, 90);
  const double y = std::stod(cell.substr(cell.find(" y=\"") + 4));
  const double height = std::stod(cell.substr(cell.find(" height=\"") + 9));
  const double image_height = 42.0 * 460.0 / 64.0;  // a chart is 460 units wide
  EXPECT_GT(height, 0.0);
  EXPECT_LE(y + height, image_height + 0.11);
}

TEST(SvgChart, SaysWhenThereIsNothingToDraw) {
  EXPECT_NE(DrawChart({}, {}).find("no data"), std::string::npos);
  EXPECT_NE(DrawBars({}, {}, {}, "y").find("no data"), std::string::npos);
  EXPECT_NE(DrawField(64, 48, 8.0, {}).find("no data"), std::string::npos);
}

TEST(SvgChart, OneValueAloneStillHasAnAxis) {
  const std::string svg = DrawChart({{"a", {{1.0, 0.0}}, true}}, {"x", "y"});
  EXPECT_EQ(Count(svg, "<circle"), 1);
  EXPECT_EQ(Count(svg, "nan"), 0);
}

TEST(SvgChart, BarsLeaveAGapWhereAValueIsMissing) {
  const std::string svg =
      DrawBars({"before", "after"}, {"x", "y"}, {{0.5, 0.4}, {std::nan(""), 0.1}}, "rate");
  EXPECT_EQ(Count(svg, "<title>"), 3);
}

TEST(SvgChart, TextCannotBecomeMarkup) {
  EXPECT_EQ(EscapeMarkup("<a & \"b\">"), "&lt;a &amp; &quot;b&quot;&gt;");
  const std::string svg = DrawBars({"<script>"}, {"<b>"}, {{1.0}}, "<i>");
  EXPECT_EQ(Count(svg, "<script>") + Count(svg, "<b>") + Count(svg, "<i>"), 0);
}

}  // namespace
}  // namespace scenecalib
