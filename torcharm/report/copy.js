for (const button of document.querySelectorAll("button.copy")) {
  const details = button.parentElement.querySelector("details");
  const text = details.querySelector("textarea");
  button.hidden = false;
  button.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(text.value);
    } catch {
      details.open = true;
      text.select();
      document.execCommand("copy");
    }
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = "Copy as CSV"; }, 2000);
  });
}
