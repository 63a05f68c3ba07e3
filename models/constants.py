"""Constants of nature and of the Earth, each with its unit and its authority."""

C_M_S = 299_792_458.0  # m/s, exact (SI)
BOLTZMANN_J_K = 1.380649e-23  # J/K, exact (SI)
T0_K = 290.0  # K, the temperature at which noise figures are stated (IEEE)

WGS84_A_M = 6_378_137.0  # m, semi-major axis (WGS 84)
WGS84_F = 1 / 298.257223563  # flattening (WGS 84)
WGS84_B_M = WGS84_A_M * (1 - WGS84_F)  # m, semi-minor axis
WGS84_E2 = WGS84_F * (2 - WGS84_F)  # first eccentricity, squared
WGS84_EP2 = WGS84_E2 / (1 - WGS84_F) ** 2  # second eccentricity, squared
