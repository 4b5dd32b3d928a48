#include "scenecalib/evaluation/rate_table.h"

#include <gtest/gtest.h>

#include "evaluation_fixture.h"

namespace scenecalib {
namespace {

TEST(RateTable, HasALinePerCameraAndRigAndTheMeanBesideThePublishedOne) {
  const std::vector<CameraConfig> cameras = {ForwardCamera("front"), ForwardCamera("rear")};
  const RatedRig rig{"a.yaml",
                     {MiscalibrationRate{0.1, 0.2, 0.3, 0.4, 0.5, 0.6},
                      MiscalibrationRate{0.3, 0.2, 0.3, 0.4, 0.5, 0.6}}};
  const std::string table = FormatRateTable(cameras, {rig});
  EXPECT_NE(table.find("front"), std::string::npos);
  EXPECT_NE(table.find("0.100  0.200  0.300  0.400  0.500  0.600"), std::string::npos);
  EXPECT_NE(table.find("0.200  0.200  0.300  0.400  0.500  0.600"),
            std::string::npos);  // mean of x
  EXPECT_NE(table.find("published                    0.210"), std::string::npos) << table;
  EXPECT_EQ(table.find("200 deg"), std::string::npos);  // no such camera, no such line
}

TEST(RateTable, SaysWhichCameraHasNoRate) {
  const std::vector<CameraConfig> cameras = {ForwardCamera("front")};
  EXPECT_NE(FormatRateTable(cameras, {{"a.yaml", {std::nullopt}}}).find("too few shared points"),
            std::string::npos);
  EXPECT_NE(FormatRateYaml(cameras, {{"a.yaml", {std::nullopt}}}).find("front: null"),
            std::string::npos);
}

}  // namespace
}  // namespace scenecalib
