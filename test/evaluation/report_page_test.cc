#include "scenecalib/evaluation/report_page.h"

#include <gtest/gtest.h>

#include <limits>

#include "evaluation_fixture.h"

namespace scenecalib {
namespace {

bool Has(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

/// Two cameras, the second not accepted.
ReportData TwoCameras() {
  ReportData data;
  data.initial = RigOf({ForwardCamera("front"), ForwardCamera("rear")});
  data.result.rig =
      RigOf({Moved(ForwardCamera("front"), {0.01, 0, 0}, {0.02, 0, 0}), ForwardCamera("rear")});
  data.result.cameras.resize(2);
  data.result.cameras[0].accepted = true;
  data.result.cameras[0].miscalibration_rate_before =
      MiscalibrationRate{0.5, 0.5, 0.5, 0.5, 0.5, 0.5};
  data.result.cameras[0].miscalibration_rate_after =
      MiscalibrationRate{0.1, 0.1, 0.1, 0.1, 0.1, 0.1};
  data.result.cameras[1].reasons = {"too dark: mean grey value 3 < 8"};
  data.evidence.cameras.resize(2);
  RoundEvidence round;
  round.rms_px = 0.5;
  data.evidence.cameras[0].rounds = {round, round};
  data.evidence.cameras[0].held_out_before_px = std::numeric_limits<double>::infinity();
  for (int i = 0; i < 100; ++i) {
    data.evidence.cameras[0].residuals.push_back(
        {{100.0, 100.0}, {0.1, 0.2}, 5.0, SurfaceKind::kGround});
  }
  data.evidence.pairs.push_back({0, 1, 42, 3.0, 0.25});
  data.map_from_lidar = *Trajectory::Create(
      {{0, Rigid3()}, {1000000000, Rigid3(Eigen::Quaterniond::Identity(), {5, 1, 0})}});
  data.stages = {{"mapping", 1.5, 200.0}, {"calibration", 2.5, 300.0}};
  data.warnings = {"40 messages <skipped>"};
  return data;
}

TEST(ReportPage, SaysTheVerdictOfEveryCameraInWords) {
  const std::string page = FormatReportPage(TwoCameras());
  EXPECT_TRUE(Has(page, "accepted 1</strong>") || Has(page, "1 of 2 cameras"));
  EXPECT_TRUE(Has(page, "<strong>rear</strong>: not accepted"));
  EXPECT_TRUE(Has(page, "too dark: mean grey value 3 &lt; 8"));
}

TEST(ReportPage, HasEverySection) {
  const std::string page = FormatReportPage(TwoCameras());
  for (const char* const title : {"Result, before and after", "Residuals", "Convergence",
                                  "Miscalibration rate", "Tracks and surfaces", "Camera to camera",
                                  "Drive and map", "Run time and memory", "Warnings"}) {
    EXPECT_TRUE(Has(page, std::string("<h2>") + title + "</h2>")) << title;
  }
  EXPECT_TRUE(Has(page, "<td>42</td>"));
  EXPECT_TRUE(Has(page, "<td>4.0</td><td>300</td>"));  // both stages together
  EXPECT_TRUE(Has(page, "40 messages &lt;skipped&gt;"));
}

TEST(ReportPage, NeedsNoNetworkAndNoScript) {
  ReportData data = TwoCameras();
  data.overlays.push_back({"front", {1, 2, 3}, {4, 5, 6}});
  const std::string page = FormatReportPage(data);
  EXPECT_FALSE(Has(page, "http"));
  EXPECT_FALSE(Has(page, "<script"));
  EXPECT_TRUE(Has(page, "data:image/jpeg;base64,AQID\""));
  EXPECT_TRUE(Has(page, "data:image/jpeg;base64,BAUG\""));
}

TEST(ReportPage, ShowsWhatCouldNotBeEvaluatedAsADashAndNotAsInfinity) {
  const std::string page = FormatReportPage(TwoCameras());
  EXPECT_FALSE(Has(page, ">inf<"));
  EXPECT_FALSE(Has(page, ">nan<"));
  EXPECT_TRUE(Has(page, "&ndash;"));
}

TEST(ReportPage, AnEmptyRunStillMakesAPage) {
  const std::string page = FormatReportPage(ReportData());
  EXPECT_TRUE(Has(page, "</html>"));
  EXPECT_TRUE(Has(page, "no data"));
}

TEST(Base64, MatchesTheExamplesOfItsStandard) {
  const auto encode = [](const std::string& text) {
    return EncodeBase64(std::vector<unsigned char>(text.begin(), text.end()));
  };
  EXPECT_EQ(encode(""), "");
  EXPECT_EQ(encode("f"), "Zg==");
  EXPECT_EQ(encode("fo"), "Zm8=");
  EXPECT_EQ(encode("foobar"), "Zm9vYmFy");
}

}  // namespace
}  // namespace scenecalib
