import re

from matplotlib.figure import Figure

from torcharm.report.svg import inline_svg, themed


def drawn(name="one", words="bars"):
    axes = Figure(figsize=(3.0, 2.0)).add_subplot(facecolor="#BBBBBB")
    axes.contourf([[0.0, 1.0], [2.0, 3.0]])
    axes.plot([0, 1], [0, 1], gid="unused", label="<line>")
    axes.legend()
    return inline_svg(axes.figure, name, words)


def test_it_is_an_element_that_names_itself_and_is_as_wide_as_the_figure():
    svg = drawn(words='"><script>')
    assert svg.startswith('<svg role="img" aria-label="&#34;&gt;&lt;script&gt;" style="max-width:288px" viewBox=')
    assert svg.count("<svg") == 1
    assert not re.search(r"<metadata|<style|<!--|<\?xml|<!DOCTYPE|<script", svg)


def test_shades_are_one_image_and_the_colour_behind_them_stays():
    svg = drawn()
    assert svg.count("<image") == 1
    assert "#bbbbbb" in svg
    assert "fill: var(--paper)" not in svg.split("</defs>")[0]


def test_black_and_white_are_those_of_the_page():
    svg = drawn()
    assert not re.search("#(000000|ffffff)", svg)
    assert "stroke: currentColor" in svg
    assert themed("#882255") == "var(--wine)"
    assert themed("#0072B2") == "#0072B2"


def test_identifiers_are_those_that_are_referred_to_and_the_figures_own():
    svg = drawn()
    identifiers = re.findall(r'\bid="([^"]*)"', svg)
    assert len(identifiers) == len(set(identifiers)) > 5
    assert all(name.startswith("one-") for name in identifiers)
    assert set(identifiers) == set(re.findall(r'(?:href="#|url\(#)([^")]+)', svg))


def test_it_is_the_same_each_time():
    assert drawn() == drawn()
    assert drawn("one").replace("one-", "two-") != drawn("two")  # paths to clip to have names of their own
