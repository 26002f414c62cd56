"""Whether a field is a state of the atmosphere at a time: one rule for every reader.

Winds are compared with an analysis, a forecast, a member of an ensemble, or the mean of an
ensemble. Averages over time, spread, percentiles, probabilities, errors, increments, climatologies
and standard deviations have the parameter and unit of winds but are refused. Sources: WMO FM 92
GRIB, code tables 4.0, 4.3, 4.7 (edition 2) and 5 (edition 1); ECMWF's MARS types; NCEP Office Note
388, section 1; CF conventions 1.11, sections 3.3, 7.3 and 7.4.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

_RANGES = {2: "range", 3: "average", 4: "accumulation", 5: "difference", 6: "average", 7: "average"}
#: GRIB2 product templates of a state: forecast, member, mean of an ensemble, hindcast member.
FORECAST, MEMBER, DERIVED, HINDCAST = 0, 1, 2, 60
_OVER_TIME = (*range(8, 15), 42, 43, 46, 47, 61, 67, 68, 72, 73, 78, 79, 91)
_TEMPLATES = {5: "probability", 6: "percentile", 7: "analysis or forecast error", 9: "probability"}
#: Generating processes (code table 4.3) whose output is not a state.
_PROCESSES = {
    **{5: "probability forecast", 6: "forecast error", 7: "analysis error", 9: "climatology"},
    **{10: "probability-weighted forecast", 18: "difference of two forecasts"},
    **{20: "analysis increment", 21: "initialization increment"},
}
_DERIVED = {
    **{2: "standard deviation", 3: "standard deviation", 4: "spread", 5: "large anomaly index"},
    **{7: "interquartile range", 8: "minimum", 9: "maximum", 11: "anomaly"},
}
#: MARS types of a state: first guess, analyses, forecasts, members, means of cluster or ensemble.
_MARS_STATES = (*range(12), 14, 17, 25, 26, 43, 45, 60, 71, 72)
_MARS_NAMES = {12: "forecast error", 13: "analysis error", 16: "probability", 18: "ensemble spread"}
_MARS_NAMES |= {20: "climatology", 30: "event probability", 33: "increment", 46: "scaled spread"}
#: MARS streams of monthly means and variances.
_MARS_MEANS = (1043, 1070, 1071, 1072, 1073, 1080, 1097, 1221, 1242, 1243)
_DATA_TYPES = {"ea", "ef", "es", "ep", "fp", "cl", "pd", "pb", "ses", "wes", "fcmean", "fcstdev"}
_DATA_TYPES |= {"4i", "me", "cs", "taes", "efi", "sot", "hcmean", "ssd", "svar"}
_WORDS = re.compile(
    r"\b(spread|sprd|spr|std|sd|stdev|stdv|stddev|standard deviations?|variances?|covariances?"
    r"|probabilit\w*|prob|percentiles?|quantiles?|deciles?|terciles?|quartiles?|median|[pq]\d\d"
    r"|climatolog\w*|climate means?|clim|normals|long term mean|anomal\w*|anoms?|departures?"
    r"|increments?|innovations?|dispersion|variability|interquartile|uncertaint\w*"
    r"|errors?|err|rms|rmse|tendenc\w*|exceedance|time averaged?"
    r"|bias(?! (correct|adjust|remov))|confidence|(ensemble|daily|monthly) (min|max)(imum|ima)?"
    r"|(monthly|daily|hourly|seasonal|annual|time) (means?|averages?)"
    r"|(means?|averages?) (monthly|daily|hourly|seasonal|annual))\b",
    re.I,
)
#: Words in the title of a file, which also describes other content.
_TITLE_WORDS = re.compile(
    r"\b(ensemble spread|standard deviations?|percentiles?|quantiles?|probabilit\w*"
    r"|climatolog(y|ies|ical)|long term means?|anomal\w*|analysis increments?|analysis errors?"
    r"|time averaged?|(monthly|daily) (means?|averages?))\b",
    re.I,
)
#: Operators of CDO and NCO, in the history of a file, whose output is not a state: statistics over
#: members except the mean, and all over time.
_OPERATORS = re.compile(
    r"\bcdo\b.*?\b((ens|zon|mer)(std1?|var1?|max|min|pctl|range|sum|skew|kurt|crps|brs)"
    r"|(tim|hour|day|mon|year|seas|run|y(hour|day|mon|seas|dmon))"
    r"(mean|avg|std1?|var1?|max|min|sum|pctl|range))\b|\bncra\b"
)
_STATISTIC_DIMENSIONS = re.compile(
    r"(quantile|percentile|probability|threshold|ensemble_statistic|statistic)s?$", re.I
)
_STATISTIC_KEYS = re.compile(r"statistic|derived|probabilit|ensemble", re.I)
_MEMBERS = ("realization", "number", "ensemble", "ens", "member", "members")
_HORIZONTAL = ("area", "lat", "latitude", "lon", "longitude", "x", "y")


def grib_statistic(edition: int, sections: Mapping[int, bytes]) -> str:
    """Reason why a GRIB field is not a state, from its sections; empty if it is one.

    Sections by number: 1 of edition 1; 1, 4 and, if there is one, 2 of edition 2.
    """
    if edition == 2:
        return _grib2(sections)
    product = sections[1]
    centre, indicator = product[4], product[20]
    if indicator not in (0, 1, 10):
        return f"not instantaneous: {_RANGES.get(indicator, 'time range')} (indicator {indicator})"
    if centre == 98 and len(product) >= 45 and product[40]:
        return _mars(product[42], int.from_bytes(product[43:45], "big"))
    # NCEP: byte 41 marks an ensemble, byte 44 its product (1: full field or mean, 2: mean)
    if centre == 7 and len(product) >= 44 and product[40] == 1 and product[43] not in (1, 2):
        return f"ensemble statistic other than a mean (product {product[43]})"
    return ""


def _mars(kind: int, stream: int) -> str:
    """Reason by ECMWF's type and stream, in its local sections."""
    if kind not in _MARS_STATES:
        name = _MARS_NAMES.get(kind, "statistic")
        return f"not an atmospheric state: {name} (MARS type {kind})"
    if stream in _MARS_MEANS:
        return f"not an atmospheric state: mean of a month (MARS stream {stream})"
    return ""


def _grib2(sections: Mapping[int, bytes]) -> str:
    identification, local, product = sections[1], sections.get(2, b""), sections[4]
    template, process = int.from_bytes(product[7:9], "big"), product[11]
    if template in _TEMPLATES:
        return f"not an atmospheric state: {_TEMPLATES[template]} (product template 4.{template})"
    if template in _OVER_TIME:
        return f"not instantaneous (product template 4.{template})"
    if template not in (FORECAST, MEMBER, DERIVED, HINDCAST):
        return f"product template 4.{template}"
    if process in _PROCESSES:
        return f"not an atmospheric state: {_PROCESSES[process]} (generating process {process})"
    # byte 35, code table 4.7: unweighted and weighted mean of all members
    if template == DERIVED and len(product) > 34 and product[34] not in (0, 1):
        name = _DERIVED.get(product[34], "")
        return f"ensemble statistic other than a mean: {name or 'other'} (code {product[34]})"
    if identification[20:21] == b"\x08":  # type of data, code table 1.4
        return "not an atmospheric state: event probability (type of data 8)"
    if int.from_bytes(identification[5:7], "big") == 98 and len(local) >= 13:
        return _mars(int.from_bytes(local[9:11], "big"), int.from_bytes(local[11:13], "big"))
    return ""


def variable_statistic(
    name: str,
    attrs: Mapping[object, object],
    coordinates: Iterable[tuple[str, Mapping[object, object]]],
    dataset: Mapping[object, object],
) -> str:
    """Reason why a variable is not a state, from its attributes; empty if it is one.

    `coordinates` are names and attributes of its dimensions and scalar coordinates, `dataset` the
    attributes of the Dataset.
    """
    methods = re.sub(r"\([^)]*\)", " ", str(attrs.get("cell_methods", "")))
    for names, method in re.findall(r"((?:\w+\s*:\s*)+)(\w+)", methods):
        dimensions = [dim for dim in re.split(r"[:\s]+", names.lower()) if dim]
        spatial = all(dim in _MEMBERS + _HORIZONTAL for dim in dimensions)
        if method != "point" and not (method == "mean" and spatial):
            return f"{' '.join(dimensions)}: {method}"
    step, kind = str(attrs.get("GRIB_stepType", "")), str(attrs.get("GRIB_dataType", ""))
    if step not in ("", "instant", "point"):
        return step
    if kind in _DATA_TYPES:
        return f"GRIB data type {kind}"
    modifier = str(attrs.get("standard_name", "")).split()[1:]
    if modifier:
        return " ".join(modifier)
    for key, coord_attrs in coordinates:
        if _STATISTIC_DIMENSIONS.search(key):
            return key
        if "climatology" in coord_attrs:
            return "climatology"
    if re.match(r"(long term )?mean\b", str(attrs.get("statistic", "")), re.I):
        return f"statistic {attrs['statistic']}"  # of NOAA PSL: over time; else "Ensemble Mean"
    for named, value in attrs.items():  # of THREDDS and NCL
        if re.search(r"statistical_(interval|process)", str(named), re.I) and str(value).strip():
            return f"{named} {value}"
    described = [name, *(attrs.get(key) for key in ("long_name", "description", "product_type"))]
    described += [value for named, value in attrs.items() if _STATISTIC_KEYS.search(str(named))]
    described += [dataset.get(key) for key in ("product_type", "statistic")]
    titles = [value for key, value in dataset.items() if str(key).lower() in ("title", "product")]
    if operator := _OPERATORS.search(str(dataset.get("history", ""))):
        return f"history: {operator[1] or operator[0]}"
    for text, words in [
        *((value, _WORDS) for value in described),
        *((t, _TITLE_WORDS) for t in titles),
    ]:
        # words in names are joined by underscores or by capital letters
        spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", str(text or ""))
        if match := words.search(re.sub(r"[_\W]+", " ", spaced)):
            return match[0]
    return ""
